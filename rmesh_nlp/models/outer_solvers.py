"""Outer solvers of the nested formulation, by name.

They take any outer objective. "newton" and "ipopt" use the second derivative of the reduced
energy, and that of any other objective by a second-order adjoint
(:mod:`rmesh_nlp.models.objective_curvature`), or for the bound of the error partly by secants
(:mod:`rmesh_nlp.models.secant_curvature`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.curved_program import curvature_of
from rmesh_nlp.models.interior import LIMITED_MEMORY, OuterResult, interior
from rmesh_nlp.models.large_moves import LargeMoves
from rmesh_nlp.models.nested_settings import NestedSettings
from rmesh_nlp.models.reduced import ReducedEnergy
from rmesh_nlp.models.reduced_program import ReducedProgram
from rmesh_nlp.optimize.callbacks import Monitor
from rmesh_nlp.optimize.newton import Evaluation
from rmesh_nlp.optimize.newton import minimise as newton
from rmesh_nlp.optimize.newton_step import Model
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.optimize.stopping import StoppedError

CONJUGATE_GRADIENTS = "projected Newton-CG"

OuterSolver = Callable[[ReducedProgram, Array, Monitor, NestedSettings], OuterResult]


def _ipopt(program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings) -> OuterResult:
    """Ipopt.

    With limited memory it ends at a residual near 1e-4 of the first one (see ``NestedSettings.tol``);
    where boxes alone keep the elements valid, Newton's steps take it from there.
    """
    result = interior(program, start, monitor, settings)
    tried = result.status in (Status.CONVERGED, Status.STALLED)
    if result.method != LIMITED_MEMORY or not tried or program.nlp.n_g:
        return result
    end = _Descent(program, monitor, settings, result.iterations)(result.q, gain=settings.tight)
    return replace(end, method=f"{LIMITED_MEMORY}, then newton")


def _newton(program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings) -> OuterResult:
    """Projected trust-region Newton-CG where boxes alone keep the elements valid, else an interior point."""
    function = program.function
    barrier = isinstance(function, ReducedEnergy) and function.relocation.objective.has_barrier
    if barrier and program.nlp.n_g == 0:
        return _large_moves(program, start, monitor, settings)
    if settings.enough is not None:
        return _Descent(program, monitor, settings)(start, stationary=np.inf, gain=settings.enough)
    if program.nlp.n_g:
        return interior(program, start, monitor, settings)
    return _Descent(program, monitor, settings)(start, gain=settings.tight)


def _newton_cg(
    program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings
) -> OuterResult:
    """Projected Newton-CG, along element areas too; an interior point from where it stalls.

    The cheapest way to a stationary point, but not to the lowest: see docs/assessment.md.
    """
    if not program.nlp.n_g:
        return _newton(program, start, monitor, settings)
    descent = _Descent(program, monitor, replace(settings, max_iterations=settings.along_areas))
    found = descent(start, gain=settings.tight)
    if found.status is Status.CONVERGED or descent.stopped:
        return replace(found, method=CONJUGATE_GRADIENTS)
    near = found.status is Status.STALLED and not descent.crowded
    end = interior(replace(program, warm=near), found.q, descent.report, settings)
    return replace(
        end,
        iterations=descent.iterations + end.iterations,
        method=f"{CONJUGATE_GRADIENTS}, then {end.method}",
    )


def _large_moves(
    program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings
) -> OuterResult:
    """Newton-CG with local trust regions, for an energy with a distortion in the place of constraints."""
    assert isinstance(program.function, ReducedEnergy)
    result = LargeMoves(program.function, settings.local_newton)(
        start,
        gain_tolerance=settings.large_moves,
        max_iterations=settings.max_iterations or 200,
        on_step=monitor,
    )
    return OuterResult(result.x, result.status, result.iterations)


@dataclass(frozen=True)
class _Timed:
    """A model whose products end the solve when its time is over.

    One step may take hundreds of products and projections on linearised element areas: where no node has a
    box and many elements are small, a single step of a mesh of 60 elements took minutes.
    """

    model: Model
    out_of_time: Callable[[], bool]

    def __call__(self, d: Array) -> Array:
        if self.out_of_time():
            raise StoppedError
        return self.model(d)

    def diagonal(self) -> Array:
        return self.model.diagonal()


class _Descent:
    """Newton-CG on the reduced objective from any start.

    Iterations are counted over all of them, and from what something else took before.
    """

    def __init__(
        self, program: ReducedProgram, monitor: Monitor, settings: NestedSettings, iterations: int = 0
    ) -> None:
        self._function = function = program.function
        self.energy = function if isinstance(function, ReducedEnergy) else function.energy
        self._curvature = curvature_of(program)
        self._program, self._monitor, self._settings = program, monitor, settings
        self.stopped = self.crowded = False
        self._walls = self.energy.validity if program.nlp.n_g else None
        self.iterations = iterations

    def __call__(
        self, start: Array, *, gain: float, stationary: float | None = None, reference: float | None = None
    ) -> OuterResult:
        """Descend from ``start`` with the tolerances and the reference of :func:`newton.minimise`."""
        nlp, before = self._program.nlp, self.iterations
        result = newton(
            self._evaluate,
            start,
            nlp.lbx,
            nlp.ubx,
            tolerance=self._program.tolerance if stationary is None else stationary,
            unit=self._program.unit,
            gain_tolerance=gain,
            reference=reference,
            max_iterations=0 if self.stopped else self._settings.max_iterations or 200,
            walls=self._walls,
            settings=self._settings.newton,
            on_step=lambda iteration, q, here: self._monitor(before + iteration, q, here.value),
        )
        self.iterations += result.iterations
        self.stopped = self.stopped or result.status is Status.INTERRUPTED
        self.crowded = result.crowded
        return OuterResult(result.x, result.status, self.iterations)

    def report(self, iteration: int, q: Array, value: float) -> bool | None:
        """Tell the monitor of an iteration of what follows the descents."""
        return self._monitor(self.iterations + iteration, q, value)

    def is_valid(self, q: Array) -> bool:
        """Whether the elements that the boxes do not keep valid are."""
        objective = getattr(self._function, "objective", self.energy.relocation.objective)
        guarded = self._program.nlp.n_g > 0 or objective.has_barrier
        return not guarded or self._program.is_valid(q)

    def _evaluate(self, q: Array) -> Evaluation | None:
        if not self.is_valid(q):
            return None
        point = self._function(q)
        return Evaluation(
            point.value,
            point.gradient,
            lambda: _Timed(self._curvature.at(point), self._program.out_of_time),
        )


OUTER_SOLVERS: dict[str, OuterSolver] = {
    "ipopt": _ipopt,
    "newton": _newton,
    "newton-cg": _newton_cg,
}
