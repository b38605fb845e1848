"""Outer solvers of the nested strategy, by name.

All but "newton-pair" take any outer objective. "newton" and "ipopt" use the second derivative of the reduced
energy, and that of any other objective by a second-order adjoint
(:mod:`rmesh_nlp.programs.objective_curvature`), or for the bound of the error partly by secants
(:mod:`rmesh_nlp.programs.secant_curvature`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import Bounds, NonlinearConstraint, minimize

from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.callbacks import Monitor
from rmesh_nlp.optimize.newton import Evaluation
from rmesh_nlp.optimize.newton import minimise as newton
from rmesh_nlp.optimize.newton_step import Model
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.programs.alternating import alternated
from rmesh_nlp.programs.curved_program import curvature_of
from rmesh_nlp.programs.interior import LIMITED_MEMORY, OuterResult, interior
from rmesh_nlp.programs.large_moves import LargeMoves
from rmesh_nlp.programs.nested_settings import NestedSettings
from rmesh_nlp.programs.recombination import Recombination
from rmesh_nlp.programs.reduced import ReducedEnergy
from rmesh_nlp.programs.reduced_program import ReducedProgram, reduced_nlp

__all__ = [
    "OUTER_SOLVERS",
    "NestedSettings",
    "OuterResult",
    "OuterSolver",
    "ReducedProgram",
    "StoppedError",
    "reduced_nlp",
]

NAN = float("nan")

CONJUGATE_GRADIENTS = "projected Newton-CG"

UNDEFINED = 1e8
"""What the solvers of scipy are told where the objective, in units of its first value, is not defined: their
line searches do not understand NaN or infinity."""


OuterSolver = Callable[[ReducedProgram, Array, Monitor, NestedSettings], OuterResult]


class StoppedError(Exception):
    """The monitor asked a solver to stop that has no other way to be told."""


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


def _newton_pair(
    program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings
) -> OuterResult:
    """Newton-CG from alternating moves and from the start, the better blocks of both, and on from there."""
    if not isinstance(program.function, ReducedEnergy):
        raise ValueError("the outer solver newton-pair needs the energy as objective: choose newton")
    descent = _Descent(program, monitor, settings)
    relocation = descent.energy.relocation
    here = descent.energy(start)
    starts = (
        alternated(relocation, start, here.gradient, settings.alternating, descent.is_valid),
        start,
    )
    points = [
        descent.energy(descent(q, stationary=np.inf, gain=settings.loose, reference=here.value).q)
        for q in starts
    ]
    if points[1].value < points[0].value:
        points.reverse()
    x, other = (descent.energy.point(point.q, point.equilibrium) for point in points)
    recombine = Recombination(relocation)
    for number, across in enumerate(settings.blocks):
        x = recombine(x, other, across, shift=number / len(settings.blocks))
    q = x[: relocation.n_q]
    if not descent.is_valid(q) or descent.energy(q).value > points[0].value:
        q = points[0].q
    if program.nlp.n_g and not descent.stopped:
        end = interior(replace(program, warm=True), q, descent.report, settings)
        return replace(
            end, iterations=descent.iterations + end.iterations, method=f"newton, then {end.method}"
        )
    return descent(q, gain=settings.tight, reference=here.value)


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


def _scipy(method: str) -> OuterSolver:
    """An outer solver of scipy.optimize with our gradient."""

    def run(program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings) -> OuterResult:
        nlp, function = program.nlp, program.function
        constraints, scale = [], program.scale
        if nlp.n_g:
            if method == "L-BFGS-B":
                raise ValueError(
                    f"l-bfgs-b knows boxes only, but with these boxes {nlp.n_g} elements could be inverted: "
                    "choose ipopt, slsqp or trust-constr, or a smaller delta"
                )
            constraints.append(
                NonlinearConstraint(
                    lambda q: program.areas(q, [])[0].full().ravel(),
                    nlp.lbg,
                    np.inf,
                    jac=lambda q: program.areas(q, [])[1].full(),
                )
            )
        count, limit = 0, settings.max_iterations or 500

        def callback(q: Array, *_: Any) -> None:
            nonlocal count
            count += 1
            if monitor(count, np.clip(q, nlp.lbx, nlp.ubx), NAN):
                raise StoppedError

        result = minimize(
            lambda q: function(q).value / scale if function.is_defined(q) else UNDEFINED,
            start,
            jac=lambda q: function(q).gradient / scale if function.is_defined(q) else np.zeros(q.size),
            method=method,
            bounds=Bounds(nlp.lbx, nlp.ubx),
            constraints=constraints,
            callback=callback,
            tol=settings.scipy_tol,
            options={"maxiter": limit},
        )
        status = Status.CONVERGED if result.success else Status.STALLED
        if count >= limit:
            status = Status.ITERATION_LIMIT
        return OuterResult(np.clip(result.x, nlp.lbx, nlp.ubx), status, count)

    return run


OUTER_SOLVERS: dict[str, OuterSolver] = {
    "ipopt": _ipopt,
    "newton": _newton,
    "newton-cg": _newton_cg,
    "newton-pair": _newton_pair,
    "slsqp": _scipy("SLSQP"),
    "trust-constr": _scipy("trust-constr"),
    "l-bfgs-b": _scipy("L-BFGS-B"),
}
