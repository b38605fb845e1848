"""The compiled NLPs of one MPCC: one per relaxation with t as a parameter, one for all branches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, Evaluator
from rmesh_nlp.mpcc.lifting import BoolArray, Lifted, lift
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.relaxations import relaxation
from rmesh_nlp.mpcc.result import Residuals, excess, residuals
from rmesh_nlp.optimize.budget import Budget
from rmesh_nlp.optimize.callbacks import Monitor
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import NLPResult, PluginOptions, Solver

_CLOCK = 2000  # unknowns of a problem whose clock is looked at after every iteration


@dataclass(frozen=True, eq=False)
class Watch:
    """Who looks at the iterations of an NLP, and how often."""

    monitor: Monitor | None = None
    only_clock: bool = False
    """Whether the monitor looks at nothing but the clock."""

    def every(self, n: int) -> int:
        """Iterations of ``n`` unknowns from one look to the next; 0 if nobody looks.

        Those of a small problem are shorter than a callback: its clock is looked at now and then.
        """
        if self.monitor is None:
            return 0
        return int(np.clip(_CLOCK // max(n, 1), 1, 20)) if self.only_clock else 1


UNWATCHED = Watch()


class CompiledNLPs:
    """Solves relaxations and branches of one MPCC.

    Nothing is rebuilt between solves: t is a parameter, a pair is fixed by a bound. Ipopt's options are
    fixed when it is made ready, so warm starts, and starts that are watched, have instances of their own.
    """

    def __init__(self, mpcc: MPCC, options: Options) -> None:
        watch = Budget()
        self.options = options
        self.lifted = lift(mpcc)
        relaxation(options.relaxation)  # an unknown name is an error now, not at the first solve
        self._solvers: dict[tuple[object, ...], _AnySize] = {}
        self.build_seconds = watch.elapsed

    @cached_property
    def _relaxed(self) -> tuple[NLP, Evaluator]:
        return relaxed_nlp(self.lifted, self.options.relaxation)

    def _solver(self, kind: tuple[object, ...], nlp: NLP, options: PluginOptions, watch: Watch) -> _AnySize:
        every = watch.every(nlp.n_x)
        key = (*kind, every)
        if key not in self._solvers:
            building = Budget()
            self._solvers[key] = _AnySize(nlp, options, every)
            self.build_seconds += building.elapsed
        return self._solvers[key]

    def relaxed(
        self,
        z: Array,
        p: Array,
        t: float,
        warm: NLPResult | None = None,
        watch: Watch = UNWATCHED,
        **how: Any,
    ) -> NLPResult:
        """Solve the relaxation at ``t`` from ``z``, and from the multipliers of ``warm``.

        The words of ``how`` are those of :meth:`Options.relaxed`.
        """
        nlp, _ = self._relaxed
        options = self.options.relaxed(nlp.n_x, warm is not None, **how)
        solver = self._solver(("relaxed", warm is not None, *sorted(how.items())), nlp, options, watch)
        return solver(z, watch.monitor, p=np.append(p, t), **_multipliers(warm))

    def branch(
        self,
        z: Array,
        p: Array,
        zero: BoolArray,
        *,
        free_signs: bool = False,
        warm: NLPResult | None = None,
        watch: Watch = UNWATCHED,
    ) -> NLPResult:
        """Solve the NLP in which the given members are zero, from ``z``.

        ``free_signs`` lets the other members be negative; ``warm`` has multipliers of the lifted NLP.
        """
        lower, upper = self._bounds_on(zero, free_signs)
        options = self.options.exact(self.lifted.nlp.n_x, warm is not None)
        solver = self._solver(("branch", warm is not None), self.lifted.nlp, options, watch)
        return solver(
            np.clip(z, lower, upper), watch.monitor, p=p, lbx=lower, ubx=upper, **_multipliers(warm)
        )

    def least_violation(self, z: Array, p: Array, zero: BoolArray, watch: Watch = UNWATCHED) -> NLPResult:
        """Minimise the sum of the violations of all rows in which the given members are zero, from ``z``.

        ``f`` is that sum.
        """
        nlp, (lower, upper) = self._elastic, self._bounds_on(zero)
        z = np.clip(z, lower, upper)
        rows, _ = self.lifted.jacobian(z, p)
        apart = np.clip(rows, nlp.lbg, nlp.ubg) - rows
        start = np.concatenate([z, np.maximum(apart, 0.0), np.maximum(-apart, 0.0)])
        solver = self._solver(("elastic",), nlp, self.options.exact(nlp.n_x), watch)
        others = np.zeros(2 * nlp.n_g)
        bounds = {"lbx": np.append(lower, others), "ubx": np.append(upper, others + np.inf)}
        result = solver(start, watch.monitor, p=p, **bounds)
        return replace(result, x=result.x[: z.size])

    @cached_property
    def _elastic(self) -> NLP:
        return elastic_nlp(self.lifted.nlp)

    def _bounds_on(self, zero: BoolArray, free_signs: bool = False) -> tuple[Array, Array]:
        """Bounds of the lifted unknowns with the given members at zero."""
        lower, upper = self.lifted.nlp.lbx.copy(), self.lifted.nlp.ubx.copy()
        if free_signs:
            lower[self.lifted.member] = -np.inf
        fixed = self.lifted.pairs[zero]
        lower[fixed] = upper[fixed] = 0.0
        return lower, upper

    def without_relaxation(self, result: NLPResult, t: float) -> NLPResult:
        """The same point; what the relaxation exerts on a member becomes the multiplier of its bound."""
        lifted, n_rows = self.lifted, self.lifted.nlp.n_g
        _, pull = self._relaxed
        lam = result.lam_x.copy()
        *forces, _ = pull(*result.x[lifted.pairs], t, result.lam_g[n_rows:])
        np.add.at(lam, lifted.pairs, np.array(forces))
        return replace(result, lam_x=lam, lam_g=result.lam_g[:n_rows], g=result.g[:n_rows])

    def cost(self, result: NLPResult, t: float) -> float:
        """What the objective would change by if t fell to zero, to first order."""
        _, pull = self._relaxed
        *_, slope = pull(*result.x[self.lifted.pairs], t, result.lam_g[self.lifted.nlp.n_g :])
        return t * abs(float(slope[0]))

    def padded(self, result: NLPResult) -> NLPResult:
        """Multipliers of the lifted NLP as a start of the relaxation: its own rows get zero."""
        n_rows = self.lifted.nlp.n_g
        extra = self._relaxed[0].n_g - n_rows
        return replace(result, lam_g=np.append(result.lam_g[:n_rows], np.zeros(extra)))

    def measure(self, z: Array, p: Array) -> tuple[float, Residuals, tuple[Array, Array, Array]]:
        """Objective, residuals and (g, G, H) of the source problem at a lifted point."""
        source = self.lifted.source
        x = z[: source.n_x]
        f, column = self.lifted.source_values(x, p[:-1])
        g, G, H = np.split(column, [source.n_g, source.n_g + source.n_pairs])
        return float(f[0]), residuals(source, x, g, G, H), (g, G, H)

    def excess(self, z: Array, p: Array) -> float:
        """Largest residual of the source problem in units of its tolerance: at most 1 is a solution.

        A row is allowed its tolerance times its largest term ``|J_ij z_j|`` (at least 1), as rounding is.
        """
        lifted, options, source = self.lifted, self.options, self.lifted.source
        x = z[: source.n_x]
        _, nonzeros = lifted.jacobian(z, p)
        row_of, column_of = lifted.pattern
        scale = np.ones(source.n_g + 2 * source.n_pairs)
        with np.errstate(invalid="ignore"):  # what is not finite is infinitely far away, below
            np.maximum.at(scale, lifted.rows[row_of], np.abs(nonzeros * z[column_of]))
        f, rows = lifted.source_values(x, p[:-1])
        lower = np.append(source.lbg, np.zeros(2 * source.n_pairs))
        upper = np.append(source.ubg, np.full(2 * source.n_pairs, np.inf))
        G, H = np.split(np.abs(rows[source.n_g :]) / scale[source.n_g :], 2)
        worst = max(
            excess(rows / scale, lower / scale, upper / scale) / options.feasibility,
            excess(x, np.asarray(source.lbx), np.asarray(source.ubx)) / options.feasibility,
            float(np.max(np.minimum(G, H), initial=0.0)) / options.complementarity,
        )
        return worst if np.isfinite(worst) and np.isfinite(f[0]) else np.inf


def _multipliers(warm: NLPResult | None) -> dict[str, Array]:
    return {} if warm is None else {"lam_x0": warm.lam_x, "lam_g0": warm.lam_g}


def relaxed_nlp(lifted: Lifted, name: str) -> tuple[NLP, Evaluator]:
    """The lifted NLP with the rows and the penalty of a relaxation, t the last parameter; and its pull.

    The pull is ``(a, b, t, lam) -> (force on a, force on b, slope in t)``, the gradient of ``penalty + lam^T
    rows``.
    """
    nlp, relax = lifted.nlp, relaxation(name)
    t = ca.MX.sym("t")
    # one unknown taken at no place is a row of none, and rows of none do not join columns
    a, b = (ca.reshape(nlp.x[places.tolist()], -1, 1) for places in lifted.pairs)
    relaxed = relax(a, b, t)
    n_rows = relaxed.rows.shape[0]
    if not relaxed.signs:
        slacks = np.full(nlp.n_x - lifted.source.n_x, -np.inf)
        nlp = replace(nlp, lbx=np.append(lifted.source.lbx, slacks))
    nlp = nlp.extended(
        p=t, f=relaxed.penalty, g=relaxed.rows, lbg=np.full(n_rows, -np.inf), ubg=np.zeros(n_rows)
    )
    a, b = (ca.MX.sym(name, lifted.source.n_pairs) for name in "ab")
    s, lam = ca.MX.sym("s"), ca.MX.sym("lam", n_rows)
    parts = relax(a, b, s)
    total = ca.MX(parts.penalty + (ca.dot(lam, parts.rows) if n_rows else 0))
    forces = [ca.densify(ca.gradient(total, part)) for part in (a, b, s)]
    return nlp, Evaluator(ca.Function("pull", [a, b, s, lam], forces))


def elastic_nlp(nlp: NLP) -> NLP:
    """``min sum(up + down)`` subject to ``lbg <= g + up - down <= ubg`` and ``up, down >= 0``."""
    apart = ca.MX.sym("apart", 2 * nlp.n_g)
    up, down = ca.vertsplit(apart, [0, nlp.n_g, 2 * nlp.n_g])
    return nlp.extended(x=apart, lbx=0, weight=0, f=ca.sum1(apart), shift=up - down)


class _AnySize:
    """A Solver that also takes NLPs with more equations than free unknowns.

    Ipopt refuses those. Idle unknowns with a quadratic term, one per row, keep it from counting; they are
    added only when a call needs them.
    """

    def __init__(self, nlp: NLP, options: PluginOptions, every: int) -> None:
        self.nlp, self._options, self._every = nlp, options, every
        self._monitor: Monitor | None = None
        self._solver = self._ready(nlp)
        self._padded: Solver | None = None

    def _ready(self, nlp: NLP) -> Solver:
        """Ipopt takes its callback when it is made ready; the monitor is that of the call."""
        watch = self._watch if self._every else None
        return Solver(nlp, options=self._options, monitor=watch, every=self._every or 1)

    def _watch(self, iteration: int, x: Array, f: float, lam_g: Array) -> bool | None:
        return None if self._monitor is None else self._monitor(iteration, x, f, lam_g)

    def __call__(self, z: Array, monitor: Monitor | None, **arguments: Array) -> NLPResult:
        self._monitor = monitor
        nlp = self.nlp
        lower, upper = arguments.get("lbx", nlp.lbx), arguments.get("ubx", nlp.ubx)
        if np.count_nonzero(nlp.lbg == nlp.ubg) <= np.count_nonzero(lower != upper):
            return self._solver(z, **arguments)
        n, extra = nlp.n_x, nlp.n_g + 1
        if self._padded is None:
            idle = type(nlp.x).sym("idle", extra)
            padded = nlp.extended(x=idle, f=0.5 * (idle.T @ idle))
            self._padded = self._ready(padded)
        for name, fill in (("lbx", -np.inf), ("ubx", np.inf), ("lam_x0", 0.0)):
            if name in arguments:
                arguments[name] = np.append(arguments[name], np.full(extra, fill))
        result = self._padded(np.append(z, np.zeros(extra)), **arguments)
        return replace(result, x=result.x[:n], lam_x=result.lam_x[:n])
