"""The compiled NLPs of one MPCC: one per relaxation with t as a parameter, one for all branches."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array, Evaluator
from rmesh_nlp.mpcc.lifting import Lifted, lift, warm_start
from rmesh_nlp.mpcc.options import DEPENDENT, Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.relaxations import relaxation
from rmesh_nlp.mpcc.result import Duals, Residuals, excess, residuals
from rmesh_nlp.optimize.callbacks import Monitor
from rmesh_nlp.optimize.nlp import NLP, Derivatives
from rmesh_nlp.optimize.solver import NLPResult, Solver

BoolArray = NDArray[np.bool_]
_CLOCK = 2000  # unknowns of a problem whose clock is looked at after every iteration


class Programs:
    """Solves relaxations and branches of one MPCC.

    Nothing is rebuilt between solves: t is a parameter, a pair is fixed by a bound. Ipopt's options are
    fixed when it is made ready, so warm starts, and starts that are watched, have instances of their own.
    """

    def __init__(self, mpcc: MPCC, options: Options) -> None:
        began = time.perf_counter()
        self.options = options
        self.lifted: Lifted = lift(mpcc)
        relaxation(options.relaxation)  # an unknown name is an error now, not at the first solve
        self._relaxations: dict[str, Relaxed] = {}
        self._solvers: dict[tuple[Any, ...], _Tolerant] = {}
        self._unlifted: NLP | None = None
        self._watch = Watch()
        self.dependent = False  # whether to reckon with equations that follow from each other
        self.only_clock = False  # whether the monitors look at nothing but the clock
        self.build_seconds = time.perf_counter() - began

    def _relaxed(self, name: str) -> Relaxed:
        """The relaxed NLP: the lifted one and the relaxation's rows, t the last parameter."""
        if name not in self._relaxations:
            self._relaxations[name] = relaxed_program(self.lifted, name)
        return self._relaxations[name]

    def _solver(self, key: tuple[Any, ...], nlp: NLP, options: dict[str, Any], watched: bool) -> _Tolerant:
        every = self._every(nlp.n_x)
        key = (*key, watched, every, self.dependent)
        if self.dependent:
            options = {**DEPENDENT, **options}
        if key not in self._solvers:
            began = time.perf_counter()
            self._solvers[key] = _Tolerant(nlp, options, self._watch if watched else None, every)
            self.build_seconds += time.perf_counter() - began
        return self._solvers[key]

    def _every(self, n: int) -> int:
        """Iterations between looks at the clock: of a small problem they are shorter than a callback."""
        return int(np.clip(_CLOCK // max(n, 1), 1, 20)) if self.only_clock else 1

    def relaxed(
        self,
        name: str,
        z: Array,
        p: Array,
        t: float,
        warm: NLPResult | None = None,
        monitor: Monitor | None = None,
        first: bool = False,
    ) -> NLPResult:
        """Solve the relaxation ``name`` at ``t`` from ``z``; ``warm`` gives multipliers to start from.

        ``first`` says that ``z`` is a user's start and not another relaxed solution.
        """
        self._watch.monitor = monitor
        nlp = self._relaxed(name).nlp
        barrier = self.options.barrier_of(t) if self.options.tie_barrier else None
        first = first and warm is None
        options = self.options.relaxed(nlp.n_x, warm is not None, barrier, first)
        key = (name, warm is not None, barrier, first)
        lam = {} if warm is None else {"lam_x0": warm.lam_x, "lam_g0": warm.lam_g}
        return self._solver(key, nlp, options, monitor is not None)(z, p=np.append(p, t), **lam)

    def unlifted(self, x: Array, p: Array, t: float, monitor: Monitor | None = None) -> NLPResult:
        """Solve Scholtes' relaxation in the unknowns of the source problem, by Ipopt's default settings.

        The point and the multipliers are given as those of the lifted program.
        """
        self._watch.monitor = monitor
        source, lifted = self.lifted.source, self.lifted
        if self._unlifted is None:
            self._unlifted = unlifted_program(source, lifted.base)
        options = self.options.unlifted(source.n_x)
        solver = self._solver(("unlifted",), self._unlifted, options, monitor is not None)
        result = solver(x, p=np.append(p, t))
        ends = np.cumsum([source.n_g, source.n_pairs, source.n_pairs])
        g, G, H, products = np.split(result.lam_g, ends)
        _, G_value, H_value, _ = np.split(result.g, ends)
        duals = Duals(result.lam_x, g, G + products * H_value, H + products * G_value)
        warm = warm_start(lifted, lifted.start(result.x, p[:-1]), 1.0, duals)
        return replace(result, x=warm.x, lam_x=warm.lam_x, lam_g=warm.lam_g, g=warm.g)

    def branch(
        self,
        z: Array,
        p: Array,
        fix_G: BoolArray,
        fix_H: BoolArray,
        *,
        box: Array | None = None,
        free_signs: bool = False,
        warm: NLPResult | None = None,
        monitor: Monitor | None = None,
    ) -> NLPResult:
        """Solve the NLP in which the given members are zero, from ``z``.

        ``box`` keeps the unknowns near ``z``; ``free_signs`` lets the other members be negative; ``warm``
        gives multipliers of the lifted program, see :meth:`without_relaxation`.
        """
        self._watch.monitor = monitor
        lifted = self.lifted
        lower, upper = lifted.nlp.lbx.copy(), lifted.nlp.ubx.copy()
        if box is not None:
            lower, upper = np.maximum(lower, z - box), np.minimum(upper, z + box)
        if free_signs:
            lower[lifted.member] = -np.inf
        for places in (lifted.first[fix_G], lifted.second[fix_H]):
            upper[places] = 0.0
            lower[places] = 0.0
        options = self.options.exact(lifted.nlp.n_x, warm is not None)
        solver = self._solver(("branch", warm is not None), lifted.nlp, options, monitor is not None)
        lam = {} if warm is None else {"lam_x0": warm.lam_x, "lam_g0": warm.lam_g}
        return solver(np.clip(z, lower, upper), p=p, lbx=lower, ubx=upper, **lam)

    def without_relaxation(self, name: str, result: NLPResult, t: float) -> NLPResult:
        """The same point with multipliers of the lifted program.

        What the relaxation's rows and penalty exert on a member becomes the multiplier of its bound.
        """
        lifted = self.lifted
        n_rows = lifted.nlp.n_g
        z = result.x
        pulls = self._relaxed(name).pull(z[lifted.first], z[lifted.second], t, result.lam_g[n_rows:])
        lam = result.lam_x.copy()
        for places, pull in zip((lifted.first, lifted.second), pulls, strict=True):
            np.add.at(lam, places, pull)
        return replace(result, lam_x=lam, lam_g=result.lam_g[:n_rows], g=result.g[:n_rows])

    def padded(self, name: str, result: NLPResult) -> NLPResult:
        """Multipliers of the lifted program as a start of a relaxation: its own rows get zero."""
        extra = self._relaxed(name).nlp.n_g - self.lifted.nlp.n_g
        return replace(result, lam_g=np.append(result.lam_g[: self.lifted.nlp.n_g], np.zeros(extra)))

    def measure(self, z: Array, p: Array) -> tuple[float, Residuals, tuple[Array, Array, Array]]:
        """Objective, residuals and (g, G, H) of the source problem at a lifted point."""
        source = self.lifted.source
        x = z[: source.n_x]
        f, column = self.lifted.source_values(x, p[:-1])
        g, G, H = np.split(column, [source.n_g, source.n_g + source.n_pairs])
        return float(f[0]), residuals(source, x, g, G, H), (g, G, H)

    def excess(self, z: Array, p: Array) -> float:
        """Largest residual of the source problem in units of its tolerance: at most 1 is a solution.

        A row is allowed its tolerance times its largest term ``|J_ij z_j|`` (at least 1): rounding is
        relative to that.
        """
        lifted, options = self.lifted, self.options
        source = lifted.source
        x = z[: source.n_x]
        _, nonzeros = lifted.jacobian(z, p)
        row_of, column_of = lifted.pattern
        scale = np.ones(source.n_g + 2 * source.n_pairs)
        np.maximum.at(scale, lifted.rows[row_of], np.abs(nonzeros * z[column_of]))
        f, rows = lifted.source_values(x, p[:-1])
        zeros, infinite = np.zeros(2 * source.n_pairs), np.full(2 * source.n_pairs, np.inf)
        lower, upper = np.append(source.lbg, zeros), np.append(source.ubg, infinite)
        pairs = np.abs(rows[source.n_g :]) / scale[source.n_g :]
        worst = max(
            excess(rows / scale, lower / scale, upper / scale) / options.feasibility,
            excess(x, np.asarray(source.lbx), np.asarray(source.ubx)) / options.feasibility,
            float(np.max(np.minimum(pairs[: source.n_pairs], pairs[source.n_pairs :]), initial=0.0))
            / options.complementarity,
        )
        return worst if np.isfinite(worst) and np.isfinite(f[0]) else np.inf


class Watch:
    """The monitor of whichever solve is running: Ipopt takes one callback, when it is made ready."""

    def __init__(self) -> None:
        self.monitor: Monitor | None = None

    def __call__(self, iteration: int, x: Array, f: float) -> bool | None:
        """Pass an iteration on."""
        return None if self.monitor is None else self.monitor(iteration, x, f)


@dataclass(frozen=True, eq=False)
class Relaxed:
    """A relaxed NLP, and the function that turns multipliers of its rows into forces on the members.

    Attributes
    ----------
    nlp : NLP
    pull : Evaluator
        ``(a, b, t, multipliers of the rows) -> (force on a, force on b)``: the gradients in the members of
        the penalty and of the rows times their multipliers.
    """

    nlp: NLP
    pull: Evaluator


def relaxed_program(lifted: Lifted, name: str) -> Relaxed:
    """Add the rows and the penalty of a relaxation to the lifted program."""
    nlp = lifted.nlp
    t = type(nlp.x).sym("t")
    # one unknown taken at no place is a row of none, and rows of none do not join columns
    a, b = (ca.reshape(nlp.x[places.tolist()], -1, 1) for places in (lifted.first, lifted.second))
    relaxed = relaxation(name)(a, b, t)
    n_rows = relaxed.rows.shape[0]
    if not relaxed.signs:
        n_x = lifted.source.n_x
        own = np.concatenate([np.asarray(lifted.source.lbx), np.full(nlp.n_x - n_x, -np.inf)])
        nlp = replace(nlp, lbx=own)
    nlp = nlp.extended(
        p=t, f=relaxed.penalty, g=relaxed.rows, lbg=np.full(n_rows, -np.inf), ubg=np.zeros(n_rows)
    )
    a, b = ca.MX.sym("a", lifted.first.size), ca.MX.sym("b", lifted.first.size)
    s, lam = ca.MX.sym("s"), ca.MX.sym("lam", n_rows)
    parts = relaxation(name)(a, b, s)
    total = parts.penalty + (ca.dot(lam, parts.rows) if n_rows else 0)
    forces = [ca.densify(ca.gradient(ca.MX(total), member)) for member in (a, b)]
    return Relaxed(nlp, Evaluator(ca.Function("pull", [a, b, s, lam], forces)))


def unlifted_program(mpcc: MPCC, base: Derivatives) -> NLP:
    """Scholtes' relaxation as one writes it first: rows ``g``, ``G >= 0``, ``H >= 0``, ``G H <= t``.

    Parameters after those of the source problem: weight of the objective, and t. Derivatives are composed
    of those of the source: symbolic ones of the products take CasADi long where pairs are dense.
    """
    n, n_g, n_p = mpcc.n_pairs, mpcc.n_g, mpcc.p.shape[0]
    x, parameters = ca.MX.sym("x", mpcc.n_x), ca.MX.sym("p", n_p + 2)
    p, w, t = ca.vertsplit(parameters, [0, n_p, n_p + 1, n_p + 2])
    ends = [0, n_g, n_g + n, n_g + 2 * n]
    f, gradient = (w * ca.densify(part) for part in base.grad_f(x, p))
    rows, jacobian = base.jac_g(x, p)
    _, G, H = ca.vertsplit(ca.densify(rows), ends)
    _, J_G, J_H = ca.vertsplit(jacobian, ends)
    g = ca.vertcat(ca.densify(rows), G * H - t)
    lam_f, lam = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", n_g + 3 * n)
    lam_g, lam_G, lam_H, products = ca.vertsplit(lam, [*ends, n_g + 3 * n])
    hess_lag = None
    if base.hess_lag is not None:
        each = base.hess_lag(x, p, w * lam_f, ca.vertcat(lam_g, lam_G + products * H, lam_H + products * G))
        mixed = ca.mtimes(J_G.T, ca.mtimes(ca.diag(products), J_H))
        hess_lag = ca.Function("nlp_hess_l", [x, parameters, lam_f, lam], [each + ca.triu(mixed + mixed.T)])
    free, zero = np.full(2 * n, np.inf), np.zeros(n)
    product_rows = ca.mtimes(ca.diag(H), J_G) + ca.mtimes(ca.diag(G), J_H)
    return NLP(
        x=x,
        p=parameters,
        f=f,
        g=g,
        lbx=np.asarray(mpcc.lbx),
        ubx=np.asarray(mpcc.ubx),
        lbg=np.concatenate([np.asarray(mpcc.lbg), np.zeros(2 * n), np.full(n, -np.inf)]),
        ubg=np.concatenate([np.asarray(mpcc.ubg), free, zero]),
        derivatives=Derivatives(
            grad_f=ca.Function("nlp_grad_f", [x, parameters], [f, gradient]),
            jac_g=ca.Function("nlp_jac_g", [x, parameters], [g, ca.vertcat(jacobian, product_rows)]),
            hess_lag=hess_lag,
            kernels=base.kernels,
        ),
    )


class _Tolerant:
    """A Solver that also takes programs with more equations than free unknowns.

    Ipopt refuses those. Idle unknowns with a quadratic term, one per row, keep it from counting; they are
    added only when a call needs them.
    """

    def __init__(
        self, nlp: NLP, options: dict[str, Any], monitor: Monitor | None = None, every: int = 1
    ) -> None:
        self.nlp, self._options, self._monitor, self._every = nlp, options, monitor, every
        self._solver = Solver(nlp, options=options, monitor=monitor, every=every)
        self._padded: Solver | None = None

    def __call__(self, z: Array, **arguments: Any) -> NLPResult:
        lower, upper = arguments.get("lbx", self.nlp.lbx), arguments.get("ubx", self.nlp.ubx)
        n_free = self.nlp.n_x - np.count_nonzero(lower == upper)
        if np.count_nonzero(self.nlp.lbg == self.nlp.ubg) <= n_free:
            return self._solver(z, **arguments)
        return self._with_idle_unknowns(z, **arguments)

    def _with_idle_unknowns(self, z: Array, **arguments: Any) -> NLPResult:
        n, extra = self.nlp.n_x, self.nlp.n_g + 1
        if self._padded is None:
            idle = type(self.nlp.x).sym("idle", extra)
            free = np.full(extra, np.inf)
            padded = self.nlp.extended(x=idle, f=0.5 * (idle.T @ idle), lbx=-free, ubx=free)
            self._padded = Solver(padded, options=self._options, monitor=self._monitor, every=self._every)
        for name, fill in (("lbx", -np.inf), ("ubx", np.inf), ("lam_x0", 0.0)):
            if name in arguments:
                arguments[name] = np.append(arguments[name], np.full(extra, fill))
        result = self._padded(np.append(z, np.zeros(extra)), **arguments)
        return replace(result, x=result.x[:n], lam_x=result.lam_x[:n])
