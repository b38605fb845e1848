"""The NLPs of one MPCC, compiled when they are first solved: relaxations, branches, violations."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np

from rmesh_nlp.mpcc.lifting import Lifted, lift
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.relaxations import RELAXATIONS
from rmesh_nlp.optimize.budget import Budget
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import PluginOptions, Solver


class CompiledNLPs:
    """The NLPs of one MPCC and their solvers.

    Nothing is rebuilt between solves: t is a parameter, a pair is fixed by a bound. Ipopt's options are fixed
    when it is made ready, so each set of them has a solver of its own.
    """

    def __init__(self, mpcc: MPCC, options: Options) -> None:
        watch = Budget()
        self.options = options
        self.lifted = lift(mpcc)
        self._solvers: dict[tuple[object, ...], Solver] = {}
        self.build_seconds = watch.elapsed

    @cached_property
    def relaxed(self) -> tuple[NLP, ca.Function]:
        """See :func:`relaxed_nlp`."""
        return relaxed_nlp(self.lifted, self.options.relaxation)

    @cached_property
    def elastic(self) -> NLP:
        """``min sum(up + down)`` subject to ``lbg <= g + up - down <= ubg`` and ``up, down >= 0``."""
        nlp, n = self.lifted.nlp, self.lifted.nlp.n_g
        apart = ca.MX.sym("apart", 2 * n)
        up, down = ca.vertsplit(apart, [0, n, 2 * n])
        return nlp.extended(x=apart, lbx=0, weight=0, f=ca.sum1(apart), shift=up - down)

    def solver(self, nlp: NLP, options: PluginOptions) -> Solver:
        """The solver of one of these NLPs, whose unknowns may have idle ones after them.

        Ipopt refuses more equations than free unknowns, which branches may have. Idle unknowns with a
        quadratic term, one per row, keep it from counting.
        """
        key = (id(nlp), *sorted(options.items()))
        if key not in self._solvers:
            building, n_fixed = Budget(), np.count_nonzero(nlp.lbx == nlp.ubx) + self.lifted.pairs.shape[1]
            if np.count_nonzero(nlp.lbg == nlp.ubg) > nlp.n_x - n_fixed:
                idle = ca.MX.sym("idle", nlp.n_g + 1)
                nlp = nlp.extended(x=idle, f=0.5 * ca.sumsqr(idle))
            self._solvers[key] = Solver(nlp, options=options)
            self.build_seconds += building.elapsed
        return self._solvers[key]


def relaxed_nlp(lifted: Lifted, name: str) -> tuple[NLP, ca.Function]:
    """The lifted NLP with the rows and the penalty of a relaxation, t the last parameter; and its slope in t.

    That is ``(z, t, lam) ->`` the derivative of ``penalty + lam^T rows``.
    """
    nlp, t = lifted.nlp, ca.MX.sym("t")
    # one unknown taken at no place is a row of none, and rows of none do not join columns
    a, b = (ca.reshape(nlp.x[places.tolist()], -1, 1) for places in lifted.pairs)
    relaxed = RELAXATIONS[name](a, b, t)
    lam = ca.MX.sym("lam", relaxed.rows.shape[0])
    slope = ca.gradient(relaxed.penalty + ca.dot(lam, relaxed.rows), t)
    if not relaxed.signs:
        slacks = np.full(nlp.n_x - lifted.source.n_x, -np.inf)
        nlp = replace(nlp, lbx=np.append(lifted.source.lbx, slacks))
    longer = nlp.extended(p=t, f=relaxed.penalty, g=relaxed.rows, ubg=0)
    return longer, ca.Function("slope", [nlp.x, t, lam], [slope])
