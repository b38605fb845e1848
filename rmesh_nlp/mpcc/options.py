"""Settings of the solver: every number that is a choice and not mathematics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from rmesh_nlp.errors import unknown
from rmesh_nlp.mpcc.relaxations import RELAXATIONS
from rmesh_nlp.optimize.activity import BOUND_OF_AN_NLP, ZERO
from rmesh_nlp.optimize.budget import Budget, Limits
from rmesh_nlp.optimize.solver import PluginOptions
from rmesh_nlp.settings import Count, Limit, Part, Positive, Seconds, Settings

_PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
_LAST = 150  # iterations of an NLP that is given up early
_ADAPTIVE = {"mu_strategy": "adaptive", "mu_oracle": "quality-function"}
_RELAXED = {"max_iter": 500, "tol": 1e-8, "bound_relax_factor": 0.0, **_ADAPTIVE}
_FIRST = {"mu_strategy": "monotone", "mu_init": 0.1}
_WARM = {"warm_start_init_point": "yes", **{f"warm_start_{push}": 1e-6 for push in _PUSHES}}
_EXACT = {
    "max_iter": _LAST,
    "tol": 1e-11, "constr_viol_tol": 1e-9, "compl_inf_tol": 1e-9, "bound_relax_factor": 0.0, **_ADAPTIVE,
    # the start is the relaxed solution: do not push it back into the interior
    "bound_push": 1e-6, "bound_frac": 1e-6,
}  # fmt: skip
_WARM_EXACT = {
    **_WARM, **{f"warm_start_{push}": 1e-9 for push in _PUSHES}, "mu_strategy": "monotone", "mu_init": 1e-9,
    "max_iter": 50,  # of 447 finishes that began next to their solution none took more than 20
}  # fmt: skip

OptionsLike: TypeAlias = "Options | Mapping[str, object] | None"
"""Options, or those of its fields that differ from the defaults."""


@dataclass(frozen=True)
class Options(Settings):
    """How an MPCC is solved.

    Attributes
    ----------
    relaxation : str
        A name in ``RELAXATIONS``.
    t0, factor, t_final : float
        Homotopy: t starts at ``t0`` and is multiplied by ``factor`` down to ``t_final``.
    moves : int
        Where neither the homotopy nor phase I finds a stationary point: so many homotopies with other t0,
        then from moved starts.
    starts, seed : int
        The lowest of so many starts: the given one and seeded random ones. A trajectory is left as soon as it
        has the objective of a former one at the same t. Limits hold for all starts together.
    crossover : float
        The exact finish is tried from the first ``t <= crossover`` at which the sides of all
        pairs are those of the step before, and anyway at ``t_final``.
    warm_duals : bool
        Start each relaxation from the multipliers of the one before.
    time_limit_s : float
        Wall time, the build included, after which the best point so far is returned, with status
        ``time_limit``. Nothing else depends on the clock.
    max_iterations : int, optional
        The same for Ipopt iterations over all NLPs.
    feasibility : float
        Tolerance of constraints, relative to ``max(1, |bound|, largest term J_ij x_j)`` of the row.
    complementarity : float
        Tolerance of ``min(|G|, |H|)``, relative to ``max(1, largest term)`` of the smaller member.
    activity : float
        What counts as an active row or bound, relative to ``1 + |bound|``; see
        :mod:`rmesh_nlp.optimize.activity`.
    corner : float
        Members of pairs below this are zero.
    stationarity : float
        Tolerance of the Lagrangian gradient and of LPEC descent, in units of ``max(1, |gradient f|)``.
    max_pivots : int
        Branches visited by the exact finish.
    ipopt_relaxed, ipopt_exact : mapping
        Ipopt options that add to or override those of the relaxed and of the exact NLPs.
    ipopt_warm : mapping
        The same for relaxed NLPs that are started with multipliers, on top of ``ipopt_relaxed``.
    ipopt : mapping
        The same for all NLPs, on top of these.
    """

    relaxation: str = "scholtes"
    t0: Positive = 1.0
    factor: Part = 0.1
    t_final: Positive = 1e-8
    moves: Limit = 6
    starts: Count = 1
    seed: Limit = 0
    crossover: Positive = 1e-2
    warm_duals: bool = False
    time_limit_s: Seconds = math.inf
    max_iterations: Count | None = None
    feasibility: Positive = 1e-8
    complementarity: Positive = 1e-8
    activity: Positive = BOUND_OF_AN_NLP
    corner: Positive = ZERO
    stationarity: Positive = 1e-6
    max_pivots: Count = 30
    ipopt_relaxed: PluginOptions = field(default_factory=dict)
    ipopt_exact: PluginOptions = field(default_factory=dict)
    ipopt_warm: PluginOptions = field(default_factory=dict)
    ipopt: PluginOptions = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.relaxation not in RELAXATIONS:
            raise unknown("relaxation", self.relaxation, RELAXATIONS)
        if self.t_final > self.t0:
            raise ValueError(f"t_final = {self.t_final} lies above t0 = {self.t0}")

    def budget(self) -> Budget:
        """A budget of its limits, from now on."""
        return Budget(Limits(self.time_limit_s, self.max_iterations))

    def relaxed(self, warm: bool, *, first: bool = False, last: bool = False) -> PluginOptions:
        """Ipopt options of a relaxed NLP, started with multipliers if ``warm``.

        The ``first`` relaxation chooses the minimum to go to. A barrier that falls monotonically keeps it
        longer in the middle, and ends in fewer poor minima; from there on the adaptive one is faster.
        The ``last`` one is given up early.
        """
        own = _RELAXED | ({"max_iter": _LAST} if last else {})
        own |= _WARM if warm else _FIRST if first else {}
        return {**own, **self.ipopt_relaxed, **(self.ipopt_warm if warm else {}), **self.ipopt}

    def exact(self, warm: bool = False) -> PluginOptions:
        """Ipopt options of an exact NLP, started with multipliers if ``warm``."""
        own = {**_EXACT, **(_WARM_EXACT if warm else {})}
        return {**own, **self.ipopt_exact, **self.ipopt}
