"""Outer solvers of the nested strategy, by name.

All but "newton-pair" take any outer objective. "newton" uses the second derivative of the reduced energy, and
that of any other objective by a second-order adjoint (:mod:`rmesh_nlp.programs.objective_curvature`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import Bounds, NonlinearConstraint, minimize

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.callbacks import Monitor
from rmesh_nlp.optimize.newton import Evaluation
from rmesh_nlp.optimize.newton import minimise as newton
from rmesh_nlp.optimize.newton_step import Model
from rmesh_nlp.optimize.nlp import NLP, Derivatives, Solver, Status
from rmesh_nlp.programs.alternating import alternated
from rmesh_nlp.programs.curvature import Curvature
from rmesh_nlp.programs.energy_program import Relocation
from rmesh_nlp.programs.large_moves import LargeMoves
from rmesh_nlp.programs.objective_curvature import ObjectiveCurvature
from rmesh_nlp.programs.recombination import Recombination
from rmesh_nlp.programs.reduced import Reduced, ReducedEnergy
from rmesh_nlp.settings import Settings, check_positive

NAN = float("nan")

UNDEFINED = 1e8
"""What the solvers of scipy are told where the objective, in units of its first value, is not defined: their
line searches do not understand NaN or infinity."""


@dataclass(frozen=True)
class NestedSettings(Settings):
    """Settings of the outer solvers; docs/notes/speed.md has the benchmarks that chose them.

    Attributes
    ----------
    max_iterations : int or None
        Of the outer solver; by default 500, and 200 for newton and newton-pair.
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
    loose : float
        The two descents of newton-pair end where the model predicts less than this part, stationary or
        not.
    alternating : float
        Length of the alternating moves that one descent of newton-pair starts with, in boxes.
    large_moves : float
        newton with a distortion in the objective ends where the model predicts less than this part of the
        gain so far.
    blocks : tuple of int
        Nodes across the blocks that newton-pair recombines, one size after the other.
    scipy_tol : float
        Tolerance of the solvers of scipy.optimize.
    ipopt : mapping
        Further Ipopt options, which override all others.
    """

    max_iterations: int | None = None
    memory: int = 50
    tol: float = 1e-6
    boxed_curvature: float = 1e-2
    tight: float = 1e-4
    loose: float = 1.5e-3
    alternating: float = 0.1
    large_moves: float = 1e-15
    blocks: tuple[int, ...] = (16, 8)
    scipy_tol: float = 1e-8
    ipopt: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        numbers = [f.name for f in fields(self) if f.name not in ("ipopt", "blocks")]
        check_positive(**{name: getattr(self, name) for name in numbers})
        if not self.blocks or not all(isinstance(size, int) and size > 0 for size in self.blocks):
            raise BadInputError(f"blocks must be whole numbers above 0, got {self.blocks!r}")

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


@dataclass(frozen=True)
class ReducedProgram:
    """The outer problem: its NLP in the moves q and the function behind its objective.

    A solver should end with a first-order residual of at most ``tolerance`` in units of ``unit``
    (:class:`rmesh_nlp.programs.residual.OuterResidual`). ``oracle`` must live as long as the NLP: CasADi
    does not own Python callbacks.
    """

    nlp: NLP
    function: Reduced
    areas: ca.Function
    oracle: ca.Callback
    is_valid: Callable[[Array], bool]
    unit: float
    tolerance: float
    out_of_time: Callable[[], bool] = lambda: False


@dataclass(frozen=True)
class OuterResult:
    """Where an outer solver stopped."""

    q: Array
    status: Status
    iterations: int


OuterSolver = Callable[[ReducedProgram, Array, Monitor, NestedSettings], OuterResult]


class StoppedError(Exception):
    """The monitor asked a solver to stop that has no other way to be told."""


def reduced_nlp(
    rel: Relocation, function: Reduced, is_valid: Callable[[Array], bool], unit: float, tolerance: float
) -> ReducedProgram:
    """The NLP ``min F(q)`` over boxes and element areas; its objective is a contact solve."""
    q, p = rel.validity.q, ca.MX(0, 1)
    areas, bound = rel.validity.assembled, rel.validity.bound
    oracle = _Oracle(function, rel.n_q)
    value, gradient = oracle(q)
    nlp = NLP(
        x=q,
        p=p,
        f=value,
        g=areas.g,
        lbx=-rel.freedoms.bound,
        ubx=rel.freedoms.bound,
        lbg=bound,
        ubg=np.full(bound.size, np.inf),
        derivatives=Derivatives(
            grad_f=ca.Function("nlp_grad_f", [q, p], [value, gradient]),
            jac_g=areas.jac_g,
            hess_lag=None,
            kernels=areas.kernels,
        ),
    )
    return ReducedProgram(nlp, function, areas.jac_g, oracle, is_valid, unit, tolerance)


class _Oracle(ca.Callback):
    """F(q) and its gradient as a CasADi Function, in units of ``|F(0)|``: a squared error may be small."""

    def __init__(self, function: Reduced, n: int) -> None:
        super().__init__()
        self._function, self._n = function, n
        self._scale = scale_of(function, n)
        self.construct("reduced_energy", {})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 2

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._n)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._n if i else 1)

    def eval(self, arg: list[ca.DM]) -> list[Any]:
        q = arg[0].full().ravel()
        if not self._function.is_defined(q):
            return [np.nan, np.full(self._n, np.nan)]  # Ipopt then takes a shorter step
        point = self._function(q)
        return [point.value / self._scale, point.gradient / self._scale]


def scale_of(function: Reduced, n: int) -> float:
    """Size of the objective on the initial mesh, the unit in which it is minimised."""
    return abs(function(np.zeros(n)).value) or 1.0


def _ipopt(program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings) -> OuterResult:
    options = settings.options(boxed=bool(np.all(np.isfinite(program.nlp.ubx))))
    result = Solver(program.nlp, options=options, monitor=monitor)(start)
    status = Status.CONVERGED if result.converged else result.status
    return OuterResult(result.x, status, result.iterations)


def _newton(program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings) -> OuterResult:
    """Projected trust-region Newton-CG; the elements that the boxes do not keep valid are its walls."""
    function = program.function
    barrier = isinstance(function, ReducedEnergy) and function.relocation.objective.has_barrier
    if barrier and program.nlp.n_g == 0:
        return _large_moves(program, start, monitor, settings)
    return _Descent(program, monitor, settings)(start, gain=settings.tight)


def _large_moves(
    program: ReducedProgram, start: Array, monitor: Monitor, settings: NestedSettings
) -> OuterResult:
    """Newton-CG with local trust regions, for an energy with a distortion in the place of constraints."""
    assert isinstance(program.function, ReducedEnergy)
    result = LargeMoves(program.function)(
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
    """Newton-CG on the reduced objective from any start; iterations are counted over all of them."""

    def __init__(self, program: ReducedProgram, monitor: Monitor, settings: NestedSettings) -> None:
        self._function = function = program.function
        self._curvature: Curvature | ObjectiveCurvature
        if isinstance(function, ReducedEnergy):
            self.energy, self._curvature = function, Curvature(function)
        else:
            self.energy = function.energy
            self._curvature = ObjectiveCurvature(function.energy, function.objective)
        self._program, self._monitor, self._settings = program, monitor, settings
        self._stopped = False
        self._walls = self.energy.validity if program.nlp.n_g else None
        self._iterations = 0

    def __call__(
        self, start: Array, *, gain: float, stationary: float | None = None, reference: float | None = None
    ) -> OuterResult:
        """Descend from ``start`` with the tolerances and the reference of :func:`newton.minimise`."""
        nlp, before = self._program.nlp, self._iterations
        result = newton(
            self._evaluate,
            start,
            nlp.lbx,
            nlp.ubx,
            tolerance=self._program.tolerance if stationary is None else stationary,
            unit=self._program.unit,
            gain_tolerance=gain,
            reference=reference,
            max_iterations=0 if self._stopped else self._settings.max_iterations or 200,
            walls=self._walls,
            on_step=lambda iteration, q, here: self._report(before + iteration, q, here.value),
        )
        self._iterations += result.iterations
        self._stopped = self._stopped or result.status is Status.INTERRUPTED
        return OuterResult(result.x, result.status, self._iterations)

    def _report(self, iteration: int, q: Array, value: float) -> None:
        self._monitor(iteration, q, value)

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
        constraints, scale = [], scale_of(function, nlp.n_x)
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
    "newton-pair": _newton_pair,
    "slsqp": _scipy("SLSQP"),
    "trust-constr": _scipy("trust-constr"),
    "l-bfgs-b": _scipy("L-BFGS-B"),
}
