"""The compiled NLPs of one MPCC: one per relaxation with t as a parameter, one for every branch."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lifting import Lifted, lift
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.relaxations import relaxation
from rmesh_nlp.mpcc.result import Residuals, Step, excess, residuals
from rmesh_nlp.optimize.nlp import NLP, NLPResult, Solver

Progress = Callable[[str], None]
BoolArray = NDArray[np.bool_]


class Programs:
    """Solves relaxations and branches of one MPCC and logs every solve.

    Nothing is rebuilt between solves: t is a parameter, a pair is fixed by a bound.
    """

    def __init__(self, mpcc: MPCC, options: Options) -> None:
        began = time.perf_counter()
        self.options = options
        self.lifted: Lifted = lift(mpcc)
        relaxation(options.relaxation)  # an unknown name is an error now, not at the first solve
        self._relaxations: dict[tuple[str, bool], _Tolerant] = {}
        self.build_seconds = time.perf_counter() - began

    def _relaxed(self, name: str, warm: bool) -> _Tolerant:
        """The relaxed NLP: the lifted one and the relaxation's rows, t the last parameter.

        Ipopt's options are fixed when it is built, so a start with multipliers has its own solver.
        """
        if (name, warm) in self._relaxations:
            return self._relaxations[name, warm]
        lifted = self.lifted
        nlp = lifted.nlp
        t = type(nlp.x).sym("t")
        relaxed = relaxation(name)(nlp.x[lifted.first.tolist()], nlp.x[lifted.second.tolist()], t)
        n_rows = relaxed.rows.shape[0]
        if not relaxed.signs:
            n_x = lifted.source.n_x
            own = np.concatenate([np.asarray(lifted.source.lbx), np.full(nlp.n_x - n_x, -np.inf)])
            nlp = replace(nlp, lbx=own)
        nlp = nlp.extended(
            p=t, f=relaxed.penalty, g=relaxed.rows, lbg=np.full(n_rows, -np.inf), ubg=np.zeros(n_rows)
        )
        self._relaxations[name, warm] = self._timed(nlp, self.options.relaxed(nlp.n_x, warm))
        return self._relaxations[name, warm]

    @cached_property
    def _exact(self) -> _Tolerant:
        return self._timed(self.lifted.nlp, self.options.exact(self.lifted.nlp.n_x))

    def _timed(self, nlp: NLP, options: dict[str, Any]) -> _Tolerant:
        began = time.perf_counter()
        solver = _Tolerant(nlp, options)
        self.build_seconds += time.perf_counter() - began
        return solver

    def relaxed(self, name: str, z: Array, p: Array, t: float, warm: NLPResult | None = None) -> NLPResult:
        """Solve the relaxation ``name`` at ``t`` from ``z``; ``warm`` gives multipliers to start from."""
        lam = {} if warm is None else {"lam_x0": warm.lam_x, "lam_g0": warm.lam_g}
        return self._relaxed(name, warm is not None)(z, p=np.append(p, t), **lam)

    def branch(
        self,
        z: Array,
        p: Array,
        fix_G: BoolArray,
        fix_H: BoolArray,
        *,
        box: Array | None = None,
        free_signs: bool = False,
    ) -> NLPResult:
        """Solve the NLP in which the given members are zero, from ``z``.

        ``box`` keeps the unknowns near ``z``; ``free_signs`` lets the other members be negative.
        """
        lifted = self.lifted
        lower, upper = lifted.nlp.lbx.copy(), lifted.nlp.ubx.copy()
        if box is not None:
            lower, upper = np.maximum(lower, z - box), np.minimum(upper, z + box)
        if free_signs:
            lower[lifted.member] = -np.inf
        for places in (lifted.first[fix_G], lifted.second[fix_H]):
            upper[places] = 0.0
            lower[places] = 0.0
        return self._exact(np.clip(z, lower, upper), p=p, lbx=lower, ubx=upper)

    def measure(self, z: Array, p: Array) -> tuple[float, Residuals, tuple[Array, Array, Array]]:
        """Objective, residuals and (g, G, H) of the source problem at a lifted point."""
        source = self.lifted.source
        x = z[: source.n_x]
        f, column = self.lifted.source_values(x, p)
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
        f, rows = lifted.source_values(x, p)
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


class Log:
    """The table of steps; each new line may be shown at once."""

    def __init__(self, programs: Programs, p: Array, progress: Progress | None) -> None:
        self.steps: list[Step] = []
        self._programs, self._p, self._progress = programs, p, progress
        if progress is not None:
            progress(Step.HEADER)

    def add(self, phase: str, t: float, result: NLPResult) -> Step:
        """Measure a solve on the source problem and append its line."""
        f, res, _ = self._programs.measure(result.x, self._p)
        step = Step(
            phase, t, f, res.constraint_violation, res.complementarity, res.product,
            result.iterations, result.status, result.seconds,
        )  # fmt: skip
        self.steps.append(step)
        if self._progress is not None:
            self._progress(step.line())
        return step


class _Tolerant:
    """A Solver that also takes programs with more equations than free unknowns.

    Ipopt refuses those. Idle unknowns with a quadratic term, one per row, keep it from counting; they are
    added only when a call needs them.
    """

    def __init__(self, nlp: NLP, options: dict[str, Any]) -> None:
        self.nlp, self._options = nlp, options
        self._solver = Solver(nlp, options=options)
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
            self._padded = Solver(padded, options=self._options)
        for name, fill in (("lbx", -np.inf), ("ubx", np.inf), ("lam_x0", 0.0)):
            if name in arguments:
                arguments[name] = np.append(arguments[name], np.full(extra, fill))
        result = self._padded(np.append(z, np.zeros(extra)), **arguments)
        return replace(result, x=result.x[:n], lam_x=result.lam_x[:n])
