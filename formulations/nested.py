"""Nested: an exact contact solve inside, an outer NLP on the energy gradient (5.7), (5.11).

u(X) is not differentiable where contact changes, L(X) = J(u(X); X) is: the term with U'
drops out. Its second derivative jumps there, so the outer solvers are quasi-Newton methods.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import Bounds, NonlinearConstraint, minimize

from rmesh_nlp.assembly import assemble
from rmesh_nlp.evaluation import Array
from rmesh_nlp.motion import validity_group
from rmesh_nlp.nlp import NLP, Derivatives, Solver, Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.reduced import ReducedEnergy
from rmesh_nlp.referee import OnStep, Referee
from rmesh_nlp.solution import Solution, Step

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
    outer: str = "ipopt",
    seed: int | None = None,
    on_step: OnStep | None = None,
) -> Solution:
    """Minimise L(X) with exact contact solves inside.

    Parameters
    ----------
    problem : ContactProblem
    outer : str
        Outer solver: "ipopt" (limited-memory BFGS), "slsqp", "trust-constr" or "l-bfgs-b".
    seed : int, optional
        Random start; by default the initial mesh.
    on_step : callable, optional
        Called after each outer iteration.

    Raises
    ------
    ValueError
        If the outer solver is unknown, or cannot hold the element areas that need it.
    """
    if outer not in OUTER_SOLVERS:
        raise ValueError(f"unknown outer solver {outer!r}: choose from {', '.join(OUTER_SOLVERS)}")
    referee = Referee(problem)
    began = time.perf_counter()
    recorder = _Recorder(referee.reduced, on_step, began)
    program = reduced_nlp(referee)
    finish = OUTER_SOLVERS[outer](program, referee.start(seed), recorder)
    seconds = time.perf_counter() - began
    return referee.judge(
        "nested",
        finish.q,
        status=finish.status,
        history=recorder.steps,
        iterations=finish.iterations,
        contact_solves=referee.reduced.contact_solves,
        wall_time_s=seconds,
        claimed_energy=finish.energy,
        seed=seed,
        extra={"outer": outer},
    )


@dataclass(frozen=True)
class ReducedProgram:
    """The outer problem: its NLP in the moves q and the function behind its objective.

    ``oracle`` must live as long as the NLP: CasADi does not own Python callbacks.
    """

    nlp: NLP
    energy: ReducedEnergy
    areas: ca.Function
    oracle: ca.Callback


@dataclass(frozen=True)
class OuterResult:
    """Where an outer solver stopped."""

    q: Array
    energy: float
    status: Status
    iterations: int


def reduced_nlp(referee: Referee) -> ReducedProgram:
    """The NLP ``min L(q)`` over boxes and element areas; its objective is a contact solve."""
    rel = referee.relocation
    q, p = ca.MX.sym("q", rel.n_q), ca.MX(0, 1)
    validity, bound = validity_group(rel.problem, rel.freedoms)
    areas = assemble([validity], q, p, bound.size)
    oracle = _Oracle(referee.reduced, rel.n_q)
    value, gradient = oracle(q)
    nlp = NLP(
        x=q,
        p=p,
        f=value,
        g=areas.g,
        lbx=-np.ones(rel.n_q),
        ubx=np.ones(rel.n_q),
        lbg=bound,
        ubg=np.full(bound.size, np.inf),
        derivatives=Derivatives(
            grad_f=ca.Function("nlp_grad_f", [q, p], [value, gradient]),
            jac_g=areas.jac_g,
            hess_lag=None,
        ),
    )
    return ReducedProgram(nlp, referee.reduced, areas.jac_g, oracle)


class _Oracle(ca.Callback):
    """L(q) and its gradient as a CasADi Function."""

    def __init__(self, energy: ReducedEnergy, n: int) -> None:
        super().__init__()
        self._energy, self._n = energy, n
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
        point = self._energy(arg[0].full().ravel())
        return [point.energy, point.gradient]


class _Recorder:
    """Turns the iterates of an outer solver into Steps."""

    def __init__(self, energy: ReducedEnergy, on_step: OnStep | None, began: float) -> None:
        self._energy, self._on_step, self._began = energy, on_step, began
        self.steps: list[Step] = []

    def __call__(self, iteration: int, q: Array, energy: float) -> None:
        point = self._energy(q)
        residual = float(np.max(np.abs(q - np.clip(q - point.gradient / abs(energy), -1, 1)), initial=0.0))
        solves, seconds = self._energy.contact_solves, time.perf_counter() - self._began
        step = Step(iteration, energy, float("nan"), 0.0, residual, solves, seconds)
        self.steps.append(step)
        if self._on_step is not None:
            self._on_step(step)


def _ipopt(program: ReducedProgram, start: Array, recorder: _Recorder) -> OuterResult:
    result = Solver(program.nlp, options=IPOPT_OPTIONS, monitor=recorder)(start)
    status = Status.CONVERGED if result.converged else result.status
    return OuterResult(result.x, result.f, status, result.iterations)


def _scipy(method: str) -> Callable[[ReducedProgram, Array, _Recorder], OuterResult]:
    """An outer solver of scipy.optimize with our gradient."""

    def run(program: ReducedProgram, start: Array, recorder: _Recorder) -> OuterResult:
        nlp, energy = program.nlp, program.energy
        constraints = []
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
            recorder(count, np.clip(q, -1, 1), energy(np.clip(q, -1, 1)).energy)

        result = minimize(
            lambda q: energy(q).energy,
            start,
            jac=lambda q: energy(q).gradient,
            method=method,
            bounds=Bounds(-1, 1),
            constraints=constraints,
            callback=callback,
            tol=SCIPY_TOLERANCE,
            options={"maxiter": SCIPY_MAX_ITERATIONS},
        )
        q = np.clip(result.x, -1, 1)
        status = Status.CONVERGED if result.success else Status.STALLED
        if count >= SCIPY_MAX_ITERATIONS:
            status = Status.ITERATION_LIMIT
        return OuterResult(q, energy(q).energy, status, count)

    return run


OUTER_SOLVERS: dict[str, Callable[[ReducedProgram, Array, _Recorder], OuterResult]] = {
    "ipopt": _ipopt,
    "slsqp": _scipy("SLSQP"),
    "trust-constr": _scipy("trust-constr"),
    "l-bfgs-b": _scipy("L-BFGS-B"),
}
