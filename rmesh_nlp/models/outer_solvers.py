"""Settings of the outer solvers of nested.

Interior-point methods (Ipopt) on the outer problem, with its second derivatives or with limited memory.

Outer solvers of the nested formulation, by name.

They take any outer objective. "newton" and "ipopt" use the second derivative of the reduced
energy, and that of any other objective by a second-order adjoint
(:mod:`rmesh_nlp.models.second_derivatives`), or for the bound of the error partly by secants
(:mod:`rmesh_nlp.models.second_derivatives`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.models.reduced_nlp import ReducedProgram, curvature_of, lifted, with_hessian
from rmesh_nlp.models.regularised_descent import LargeMoves
from rmesh_nlp.optimize.callbacks import Monitor
from rmesh_nlp.optimize.newton_settings import LocalNewtonSettings, NewtonSettings
from rmesh_nlp.optimize.newton_step import Model
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import Solver
from rmesh_nlp.optimize.status import Status, StoppedError
from rmesh_nlp.optimize.trust_region import Evaluation
from rmesh_nlp.optimize.trust_region import minimise as newton
from rmesh_nlp.settings import Count, Positive, Settings


@dataclass(frozen=True)
class NestedSettings(Settings):
    """Settings of the outer solvers; docs/notes/speed.md has the benchmarks that chose them.

    Attributes
    ----------
    max_iterations : int or None
        Of the outer solver; by default 500, and 200 for newton.
    exact : int
        Number of moves up to which an interior point has the Hessian of an objective other than the energy, a
        dense matrix. That of the energy is sparse in moves and displacements together, for any number.
    along_areas : int
        Iterations after which newton-cg hands over to an interior point where element areas are constraints.
    tol_exact, acceptable_tol_exact : float
        Ipopt's least tolerances then, in units of the gradient on the given mesh. Many constraints are
        weakly active, and an interior point meets those only to the square root of its tolerance: it is the
        square of the strategy's ``tolerance`` where that is larger. Where rounding stops it before, the
        looser one will do.
    warm_barrier, warm_push : float
        Ipopt's first barrier and least distance to bounds where the start is given. Of 1e-4, 1e-6 and 1e-8,
        with six problems started at their minimisers and least areas that are smaller by 1e-4, 1e-8 took 4 to
        21 iterations and ended in the same valley each time; larger ones took more, and left it once.
    memory : int
        Updates that Ipopt's limited-memory BFGS keeps: the flat directions of the mesh make short
        memories stall.
    tol : float
        Ipopt's tolerance, in units of the objective on the given mesh. What the tolerance of the solve
        amounts to would be 1e-8 to 1e-7, where limited-memory BFGS stalls: on 6.2 it took 852 contact
        solves in place of 119, and the residual did not fall below 1e-4 of the initial one.
    boxed_curvature : float
        Curvature before any update where every node has a box. Moves are then in units of boxes and
        the objective in units of its first value, and Ipopt's 1 would make the first steps tiny, or
        all of them where the function is concave and no update is taken.
    tight : float
        newton ends where the point is stationary to the tolerance of the solve, and the model predicts
        less than this part of the gain so far.
    enough : float, optional
        newton ends where the model predicts less than this part of the gain so far, stationary or not; by
        default only at a stationary point. On a plate of 4,462 nodes with boxes 20 iterations of 200 and
        more have 99.7 % of the gain, after which the residual falls slowly.
    large_moves : float
        newton with a distortion in the objective ends where the model predicts less than this part of the
        gain so far.
    newton : NewtonSettings
        Numbers of the descents of newton.
    local_newton : LocalNewtonSettings
        Those of newton with a distortion in the objective.
    ipopt : mapping
        Further Ipopt options, which override all others.
    """

    max_iterations: Count | None = None
    exact: Count = 1500
    along_areas: Count = 40
    tol_exact: Positive = 1e-12
    acceptable_tol_exact: Positive = 1e-9
    warm_barrier: Positive = 1e-8
    warm_push: Positive = 1e-6
    memory: Count = 50
    tol: Positive = 1e-6
    boxed_curvature: Positive = 1e-2
    tight: Positive = 1e-4
    enough: Positive | None = None
    large_moves: Positive = 1e-15
    newton: NewtonSettings = field(default_factory=NewtonSettings)
    local_newton: LocalNewtonSettings = field(default_factory=LocalNewtonSettings)
    ipopt: Mapping[str, Any] = field(default_factory=dict)

    def options(self, boxed: bool) -> dict[str, Any]:
        """Ipopt's options."""
        found = {
            "hessian_approximation": "limited-memory",
            "limited_memory_max_history": self.memory,
            # after two skipped updates in a row Ipopt forgets the memory, and then crawls
            "limited_memory_max_skipping": 1_000_000,
            "tol": self.tol,
            "max_iter": self.max_iterations or 500,
        }
        if boxed:
            found["limited_memory_init_val"] = self.boxed_curvature
        return {**found, **self.ipopt}

    def exact_options(self, factor: float, warm: bool, tolerance: float) -> dict[str, Any]:
        """Ipopt's options where it has exact Hessians, and ``factor`` times the objective."""
        names = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
        near = {"mu_init": self.warm_barrier, **dict.fromkeys(names, self.warm_push)}
        return {
            **(near if warm else {}),
            "tol": max(self.tol_exact, tolerance**2),
            "acceptable_tol": max(self.acceptable_tol_exact, tolerance**2),
            "max_iter": self.max_iterations or 500,
            "nlp_scaling_method": "none",
            "obj_scaling_factor": factor,
            **self.ipopt,
        }


EXACT = "interior point with exact Hessians"

ROUNDING = 1e-12
"""Part of its value by which an objective may be above that at the start: the error of a contact solve."""

LIMITED_MEMORY = "interior point with limited memory"


@dataclass(frozen=True)
class OuterResult:
    """Where an outer solver stopped.

    ``method`` names what it ran, where its name leaves that open.
    """

    q: Array
    status: Status
    iterations: int
    method: str = ""


def interior(
    program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings
) -> OuterResult:
    """Ipopt with second derivatives where they can be had, else with limited memory; never above the start.

    Those of the energy are sparse in moves and displacements together
    (:mod:`rmesh_nlp.models.reduced_nlp`); those of other objectives are a dense matrix, for up to
    ``settings.exact`` moves.
    """
    if isinstance(program.function, ReducedEnergy):
        larger = lifted(program)
        return _run(program, larger.nlp, larger.start(start), monitor, _exact(program, settings), EXACT)
    if program.nlp.n_x <= settings.exact:
        return _run(program, with_hessian(program).nlp, start, monitor, _exact(program, settings), EXACT)
    options = settings.options(boxed=bool(np.all(np.isfinite(program.nlp.ubx))))
    return _run(program, program.nlp, start, monitor, options, LIMITED_MEMORY)


def _exact(program: ReducedProgram, settings: NestedSettings) -> dict[str, Any]:
    return settings.exact_options(program.scale / program.unit, program.warm, program.tolerance)


def _run(
    program: ReducedProgram, nlp: NLP, first: Array, monitor: Monitor, options: dict[str, Any], method: str
) -> OuterResult:
    """A solve from ``first``, whose leading unknowns are the moves.

    It ends as soon as the moves are stationary by the measure that counts. Ipopt's own test is of its
    multipliers, and where rounding keeps them from its tolerance it would go on for dozens of contact solves.
    """
    n, stationary = program.nlp.n_x, False
    start, function = first[:n], program.function
    most = function(start).value
    most += ROUNDING * abs(most)

    def watch(iteration: int, x: Array, f: float) -> bool:
        nonlocal stationary
        stop = bool(monitor(iteration, x[:n], f))
        q = np.clip(x[:n], program.nlp.lbx, program.nlp.ubx)
        if not stop and iteration > 0 and program.is_valid(q):
            point = function(q)
            stationary = point.value <= most and program.residual(point) <= program.tolerance
        return stop or stationary

    result = Solver(nlp, options=options, monitor=watch)(first)
    q = np.clip(result.x[:n], program.nlp.lbx, program.nlp.ubx)
    if not (np.isfinite(result.f) and function(q).value <= most):
        status = Status.STALLED if result.converged else result.status
        return OuterResult(start, status, result.iterations, method)
    status = Status.CONVERGED if result.converged or stationary else result.status
    return OuterResult(q, status, result.iterations, method)


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
