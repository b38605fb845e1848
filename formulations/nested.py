"""Nested: an exact contact solve inside, an outer NLP on the energy gradient (5.7), (5.11).

u(X) is not differentiable where contact changes, L(X) = J(u(X); X) is: the term with U'
drops out. Its second derivative jumps there, so the outer solvers are quasi-Newton methods.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import Bounds, NonlinearConstraint, minimize

from rmesh_nlp.assembly import assemble
from rmesh_nlp.evaluation import Array
from rmesh_nlp.motion import validity_group
from rmesh_nlp.nlp import NLP, Derivatives, Solver, Status
from rmesh_nlp.objectives import parse_objective
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.reduced import ReducedEnergy, ReducedObjective
from rmesh_nlp.referee import OnStep, Referee
from rmesh_nlp.solution import Solution, Step

NAN = float("nan")

Reduced = ReducedEnergy | ReducedObjective

IPOPT_OPTIONS: Mapping[str, Any] = {
    "hessian_approximation": "limited-memory",
    "limited_memory_max_history": 50,
    "tol": 1e-6,
    "max_iter": 500,
}
"""A long memory: the flat directions of the mesh make short ones stall."""

SCIPY_TOLERANCE = 1e-8
SCIPY_MAX_ITERATIONS = 500


def solve(
    problem: ContactProblem,
    *,
    objective: str = "energy",
    outer: str = "ipopt",
    seed: int | None = None,
    start: Array | None = None,
    on_step: OnStep | None = None,
) -> Solution:
    """Minimise an outer objective with exact contact solves inside.

    The energy needs no adjoint; other objectives get one with the active set held, which is
    their gradient wherever strict complementarity holds. The contact nodes where it fails at
    the end are listed in the record as ``biactive_nodes``: they are what may have stopped it.

    Parameters
    ----------
    problem : ContactProblem
    objective : str
        Terms of :mod:`rmesh_nlp.objectives`, such as "energy" or "error-l2 + 0.01*quality".
    outer : str
        Outer solver: "ipopt" (limited-memory BFGS), "slsqp", "trust-constr" or "l-bfgs-b".
    seed : int, optional
        Random start; by default the initial mesh.
    start : (2, nodes) array, optional
        Node positions to start from, say prolonged from a coarser mesh.
    on_step : callable, optional
        Called after each outer iteration.

    Raises
    ------
    ValueError
        If the objective or the outer solver is unknown, or the solver cannot hold the element
        areas that need it.
    """
    if outer not in OUTER_SOLVERS:
        raise ValueError(f"unknown outer solver {outer!r}: choose from {', '.join(OUTER_SOLVERS)}")
    referee = Referee(problem)
    began = time.perf_counter()
    outer_objective = parse_objective(objective)
    function: Reduced = referee.reduced
    if not outer_objective.is_energy:
        function = ReducedObjective(referee.reduced, outer_objective)
    recorder = _Recorder(function, referee.relocation.freedoms.bound, on_step, began)
    program = reduced_nlp(referee, function)
    finish = OUTER_SOLVERS[outer](program, referee.start(seed, start), recorder)
    seconds = time.perf_counter() - began
    return referee.judge(
        "nested",
        finish.q,
        status=finish.status,
        history=recorder.steps,
        iterations=finish.iterations,
        contact_solves=referee.reduced.contact_solves,
        wall_time_s=seconds,
        objective=objective,
        seed=seed,
        extra={"outer": outer, **_outer_figures(referee, function, finish.q)},
        outer_gradient=function(finish.q).gradient,
    )


@dataclass(frozen=True)
class ReducedProgram:
    """The outer problem: its NLP in the moves q and the function behind its objective.

    ``oracle`` must live as long as the NLP: CasADi does not own Python callbacks.
    """

    nlp: NLP
    function: Reduced
    areas: ca.Function
    oracle: ca.Callback


@dataclass(frozen=True)
class OuterResult:
    """Where an outer solver stopped."""

    q: Array
    status: Status
    iterations: int


def reduced_nlp(referee: Referee, function: Reduced) -> ReducedProgram:
    """The NLP ``min F(q)`` over boxes and element areas; its objective is a contact solve."""
    rel = referee.relocation
    q, p = ca.MX.sym("q", rel.n_q), ca.MX(0, 1)
    validity, bound = validity_group(rel.problem, rel.freedoms)
    areas = assemble([validity], q, p, bound.size)
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
        ),
    )
    return ReducedProgram(nlp, function, areas.jac_g, oracle)


class _Oracle(ca.Callback):
    """F(q) and its gradient as a CasADi Function, in units of ``|F(0)|``: a squared error may be small."""

    def __init__(self, function: Reduced, n: int) -> None:
        super().__init__()
        self._function, self._n = function, n
        self._scale = _scale(function, n)
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
        point = self._function(arg[0].full().ravel())
        return [point.value / self._scale, point.gradient / self._scale]


def _scale(function: Reduced, n: int) -> float:
    return abs(function(np.zeros(n)).value) or 1.0


def _outer_figures(referee: Referee, function: Reduced, q: Array) -> dict[str, Any]:
    """Record entries of an outer objective: its value before and after, and biactive nodes."""
    start, end = function(np.zeros(q.size)), function(q)
    weak = referee.model.contact_nodes[end.weak]
    return {
        "objective_initial": start.value,
        "objective_value": end.value,
        "outer_stationarity_residual": referee.reduced.stationarity_residual(end),
        "biactive_nodes": [int(node) for node in weak],
    }


class _Recorder:
    """Turns the iterates of an outer solver into Steps."""

    def __init__(self, function: Reduced, bound: Array, on_step: OnStep | None, began: float) -> None:
        self._function, self._bound, self._on_step, self._began = function, bound, on_step, began
        self.steps: list[Step] = []

    def __call__(self, iteration: int, q: Array, _: float) -> None:
        point = self._function(q)
        scale = max(abs(point.value), 1e-300)
        move = np.clip(q - point.gradient / scale, -self._bound, self._bound) - q
        residual = float(np.max(np.abs(move), initial=0.0))
        solves, seconds = self._function.contact_solves, time.perf_counter() - self._began
        step = Step(iteration, point.equilibrium.energy, NAN, 0.0, residual, solves, seconds)
        self.steps.append(step)
        if self._on_step is not None:
            self._on_step(replace(step, q=q.copy()))


def _ipopt(program: ReducedProgram, start: Array, recorder: _Recorder) -> OuterResult:
    result = Solver(program.nlp, options=IPOPT_OPTIONS, monitor=recorder)(start)
    status = Status.CONVERGED if result.converged else result.status
    return OuterResult(result.x, status, result.iterations)


def _scipy(method: str) -> Callable[[ReducedProgram, Array, _Recorder], OuterResult]:
    """An outer solver of scipy.optimize with our gradient."""

    def run(program: ReducedProgram, start: Array, recorder: _Recorder) -> OuterResult:
        nlp, function = program.nlp, program.function
        constraints, scale = [], _scale(function, nlp.n_x)
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
        count = 0

        def callback(q: Array, *_: Any) -> None:
            nonlocal count
            count += 1
            recorder(count, np.clip(q, nlp.lbx, nlp.ubx), NAN)

        result = minimize(
            lambda q: function(q).value / scale,
            start,
            jac=lambda q: function(q).gradient / scale,
            method=method,
            bounds=Bounds(nlp.lbx, nlp.ubx),
            constraints=constraints,
            callback=callback,
            tol=SCIPY_TOLERANCE,
            options={"maxiter": SCIPY_MAX_ITERATIONS},
        )
        status = Status.CONVERGED if result.success else Status.STALLED
        if count >= SCIPY_MAX_ITERATIONS:
            status = Status.ITERATION_LIMIT
        return OuterResult(np.clip(result.x, nlp.lbx, nlp.ubx), status, count)

    return run


OUTER_SOLVERS: dict[str, Callable[[ReducedProgram, Array, _Recorder], OuterResult]] = {
    "ipopt": _ipopt,
    "slsqp": _scipy("SLSQP"),
    "trust-constr": _scipy("trust-constr"),
    "l-bfgs-b": _scipy("L-BFGS-B"),
}
