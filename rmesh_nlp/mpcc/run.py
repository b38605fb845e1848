"""One solve under way: every NLP passes here, is measured, logged, shown, and counted against the limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array, Mask, is_finite, magnitude
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.result import Iterate, Stage, excess, residuals
from rmesh_nlp.optimize.budget import Budget, StoppedError
from rmesh_nlp.optimize.callbacks import Monitor
from rmesh_nlp.optimize.solver import NLPResult, Solver
from rmesh_nlp.optimize.status import Status

Watchers = tuple[Callable[[str], None] | None, Callable[[Iterate], None] | None]
"""Who is told of lines, one per NLP, and of iterations."""
Warm = tuple[Array, Array] | None
"""Multipliers to start from: of the unknowns, and of the rows, those of the problem first."""


class Run:
    """The NLPs of one solve: their table, their limits, and the best point so far.

    Attributes
    ----------
    z0 : array
        Start.
    p : array
        Parameters of the lifted problem: those of the source problem and the weight of the objective.
    steps : list of Stage
    nearest : (z, f, excess)
        The point with the smallest residuals an NLP ended at, of exact ones the lowest; first the start.
    limit : Status or None
        The limit that ended it.
    is_infeasible : bool
        Whether a local minimum of the violation was shown.
    rescues : int
        Trajectories that were tried beside the first.
    curvature : str
        As in ``MPCCResult``, at the best end.
    """

    def __init__(
        self,
        nlps: CompiledNLPs,
        z0: Array,
        p: Array,
        weight: float = 1.0,
        watchers: Watchers = (None, None),
        budget: Budget | None = None,
    ) -> None:
        self.nlps, self.lifted, self.options = nlps, nlps.lifted, nlps.options
        self.z0, self.p = z0, np.append(p, weight)
        self.steps: list[Stage] = []
        self.watch, self.built = Budget(), nlps.build_seconds
        self.budget = budget or nlps.options.budget()
        self._before = self.budget.iterations
        self.nearest = z0, np.nan, np.inf
        self.limit: Status | None = None
        self.is_infeasible, self.rescues, self.curvature = False, 0, "not tested"
        self._progress, self._on_iteration = watchers
        if self._progress is not None:
            self._progress(Stage.HEADER)

    @contextmanager
    def limited(self) -> Iterator[None]:
        """What runs in this context is left at a limit, which is remembered."""
        try:
            yield
        except StoppedError as stop:
            self.limit = stop.status

    def relaxed(self, z: Array, t: float, warm: Warm = None, **how: bool) -> NLPResult:
        """Solve the relaxation at ``t`` from ``z``; ``how`` as :meth:`Options.relaxed`.

        What stopped at a feasible point before it converged is acceptable: a smaller t may settle it.
        """
        nlp, _ = self.nlps.relaxed
        solver = self.nlps.solver(nlp, self.options.relaxed(warm is not None, **how))
        result = self.solve("relaxed", t, solver, z, warm, p=np.append(self.p, t))
        allowed = self.options.feasibility * (1 + magnitude(result.x))
        is_left = result.status in (Status.ITERATION_LIMIT, Status.STALLED)
        if is_left and excess(result.g, nlp.lbg, nlp.ubg) <= allowed:
            return replace(result, status=Status.ACCEPTABLE)
        return result

    def branch(self, z: Array, zero: Mask, *, warm: Warm = None) -> NLPResult:
        """Solve the NLP in which the given members are zero, from ``z``."""
        lower, upper = self._bounds(zero)
        solver = self.nlps.solver(self.lifted.nlp, self.options.exact(warm is not None))
        start = np.clip(z, lower, upper)
        return self.solve("branch", 0.0, solver, start, warm, p=self.p, lbx=lower, ubx=upper)

    def least_violation(self, z: Array, zero: Mask) -> NLPResult:
        """Minimise the sum of the violations of all rows in which the given members are zero, from ``z``.

        ``f`` is that sum.
        """
        nlp, (lower, upper) = self.nlps.elastic, self._bounds(zero)
        z = np.clip(z, lower, upper)
        rows, _ = self.lifted.jacobian(z, self.p)
        apart = np.clip(rows, nlp.lbg, nlp.ubg) - rows
        start = np.concatenate([z, np.maximum(apart, 0.0), np.maximum(-apart, 0.0)])
        lower, upper = np.append(lower, nlp.lbx[z.size :]), np.append(upper, nlp.ubx[z.size :])
        solver = self.nlps.solver(nlp, self.options.exact())
        return self.solve("feasible", 0.0, solver, start, p=self.p, lbx=lower, ubx=upper)

    def _bounds(self, zero: Mask) -> tuple[Array, Array]:
        """Bounds of the lifted unknowns with the given members at zero."""
        lower, upper = self.lifted.nlp.lbx.copy(), self.lifted.nlp.ubx.copy()
        fixed = self.lifted.pairs[zero]
        lower[fixed] = upper[fixed] = 0.0
        return lower, upper

    def solve(
        self, phase: str, t: float, solver: Solver, z: Array, warm: Warm = None, **arguments: Array
    ) -> NLPResult:
        """Solve an NLP within the limits, watched and recorded; idle unknowns of the solver are left out."""
        self.budget.check()
        before, n, idle = self.budget.iterations, self.lifted.nlp.n_x, np.zeros(solver.nlp.n_x - z.size)
        if warm is not None:  # rows that only one of two NLPs has come last
            n_g = solver.nlp.n_g
            arguments |= {"lam_x0": warm[0], "lam_g0": np.append(warm[1], np.zeros(n_g))[:n_g]}
        for name, fill in (("lbx", -np.inf), ("ubx", np.inf), ("lam_x0", 0.0)):
            if name in arguments:
                arguments[name] = np.append(arguments[name], idle + fill)
        result = solver(np.append(z, idle), monitor=self.monitor(phase, t), **arguments)
        result = replace(result, x=result.x[:n], lam_x=result.lam_x[:n])
        self.budget.iterations = before + result.iterations
        self.record(phase, t, result)
        self.budget.check()
        return result

    def record(self, phase: str, t: float, result: NLPResult) -> None:
        """Measure the end of an NLP on the source problem and show it."""
        measured = self._measured(phase, t, result.x)
        point = result.x, measured["objective"], self.excess(result.x)
        self.nearest = min(self.nearest, point, key=_order)
        step = Stage(
            **measured,
            iterations=result.iterations,
            status=result.status,
            seconds=result.seconds,
            multiplier=float(np.max(result.lam_g[self.lifted.nlp.n_g :], initial=0.0)) if t > 0 else 0.0,
        )
        self.steps.append(step)
        if self._progress is not None:
            self._progress(step.line())

    def objective(self, z: Array) -> float:
        """Weighted objective at a lifted point, as in a ``Finish``."""
        return float(self.lifted.value(z, self.p)[0][0])

    def measure(self, z: Array, scale: Array | float = 1.0) -> tuple[float, dict[str, Any], Array]:
        """Objective, residuals and vertcat(g, G, H) of the source problem at a lifted point."""
        x = z[: self.lifted.source.n_x]
        f, column = self.lifted.source_values(x, self.p[:-1])
        return float(f[0]), residuals(self.lifted.source, x, column, scale), column

    def exact(self, z: Array) -> bool:
        """Whether the source problem is feasible and complementary at ``z``, within the scaled tolerances."""
        return self.excess(z) <= 1.0

    def excess(self, z: Array) -> float:
        """Largest residual of the source problem in units of its tolerance: at most 1 is a solution.

        A row is allowed its tolerance times its largest term ``|J_ij z_j|`` (at least 1), as rounding is.
        """
        lifted, options = self.lifted, self.options
        if not is_finite(z):
            return np.inf
        _, nonzeros = lifted.jacobian(z, self.p)
        row_of, column_of = lifted.pattern
        scale = np.ones(lifted.source.n_g + 2 * lifted.source.n_pairs)
        with np.errstate(invalid="ignore"):  # what is not finite is infinitely far away, below
            np.maximum.at(scale, lifted.rows[row_of], np.abs(nonzeros * z[column_of]))
        f, res, _ = self.measure(z, scale)
        violation = res["constraint_violation"] / options.feasibility
        worst = max(violation, res["complementarity"] / options.complementarity)
        return worst if is_finite([worst, f]) else np.inf

    def cost(self, result: NLPResult, t: float) -> float:
        """What the objective would change by if t fell to zero, to first order."""
        _, slope = self.nlps.relaxed
        return t * abs(float(slope(result.x, t, result.lam_g[self.lifted.nlp.n_g :])))

    @property
    def iterations(self) -> int:
        """Ipopt iterations spent."""
        return self.budget.iterations - self._before

    def monitor(self, phase: str, t: float) -> Monitor:
        """What an NLP calls after each iteration."""
        budget, before, n = self.budget, self.budget.iterations, self.lifted.nlp.n_x

        def after(iteration: int, z: Array, *_: object) -> bool:
            budget.iterations = before + iteration
            if self._on_iteration is not None:
                measured = self._measured(phase, t, z[:n])
                x = z[: self.lifted.source.n_x]
                self._on_iteration(Iterate(iteration=self.iterations, x=x, **measured))
            return budget.is_over()

        return after

    def _measured(self, phase: str, t: float, z: Array) -> dict[str, Any]:
        f, res, column = self.measure(z)
        near = max(self.options.corner, 2 * np.sqrt(t))  # the corner of every relaxation is at sqrt(t)
        pairs = np.abs(column[self.lifted.source.n_g :]).reshape(2, -1)
        biactive = int(np.count_nonzero(np.max(pairs, axis=0) <= near))
        return {"phase": phase, "t": t, "objective": f, "biactive": biactive, **res}


def _order(point: tuple[Array, float, float]) -> tuple[float, float]:
    """Sort key of the nearest point: its residual, of exact ones the objective."""
    return max(point[2], 1.0), point[1]
