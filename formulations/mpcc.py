"""All at once: the contact problem as KKT conditions, an MPCC in positions, displacement and forces.

The complementarity of contact and friction is relaxed with a parameter t, and t goes down from
``t0`` to the end, from the start that is given, for every outer objective. For the energy it ends
where ``joint`` does, and the multipliers of the equilibrium constraints vanish there (the term
with U' drops out, seen from the other side). It is meant for outer objectives for which the
levels do not collapse.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from formulations.joint import ACCEPTABLE, is_above, pull
from formulations.kinks import is_stationary
from rmesh_nlp.contact.system import ActiveSet, Equilibrium
from rmesh_nlp.errors import unknown
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.kkt_model import COMMON, TIGHT_OTHERS, Bilevel, bilevel, in_units_of
from rmesh_nlp.mpcc import MPCC, RELAXATIONS, MPCCResult, MPCCSolver, Options
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import Open
from rmesh_nlp.solving.formulation import Formulation
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Part, Work

OPTIONS: Mapping[str, Any] = {
    "t0": 1e-2,
    "factor": 0.1,
    "t_final": 1e-9,
    "crossover": 1e-2,
    "warm_duals": True,
    # Hundreds of move limits are weakly active at the end: an active-set Newton method does not find which.
    "newton_finish": False,
    # Random positions and displacements are no start: a load that no design carries takes 3 s, 14 s with six.
    "moves": 0,
}
"""Options of :class:`rmesh_nlp.mpcc.Options` for mesh problems. t is in units of the largest displacement
on the given mesh times its largest nodal load."""

OF_ALL_SOLVES = ("starts", "seed", "time_limit_s", "max_iterations")
"""Options of :class:`rmesh_nlp.mpcc.Options` that every solve has by itself."""

PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
"""Ipopt options that push a start off its bounds."""

CENTRED: Mapping[str, Any] = {
    "mu_init": 2.0,
    "mu_linear_decrease_factor": 0.5,
    "mu_superlinear_decrease_power": 1.2,
}
"""Ipopt's barrier in the first relaxation of the energy where nodes have move limits: it begins where that of
``joint`` does, and falls slowly, so that the path keeps near the central one, on which the nodes choose their
corners, and ends in the minima of ``joint``. With Ipopt's own barrier fresh random problems lose nothing and
take 0.69 of the iterations, 6.1 with 8 squares a side ends 0.33 % of the gain higher."""

LOOSE, BETWEEN, TIGHT = 1e-4, 1e-8, 1e-10
"""Ipopt's tolerance in the first relaxation, in the later ones, in the exact finish."""

FACTOR_OTHERS = 0.01
"""By how much t falls from stage to stage for objectives other than the energy.

There the relaxed solution moves with t, so an exact finish after 1e-2 and 1e-3 starts far from its end.
With 0.1 seven solves took 392 iterations, with 0.01 310, to the same ends (error-l2 on 6.1 with 5, 6, 10
and 12 squares, error-h1 with 6 and 10, energy+0.1*quality on 6.2 with 8 x 4)."""

AFTER: Mapping[str, Any] = {"t0": 1e-9, "t_final": 1e-9}
"""Options from a start near a minimiser: only the relaxation at the final t, and the exact finish."""

BARRIER_AFTER = 1e-10
"""Ipopt's barrier at the end of the energy NLP: its tolerance there."""


def homotopy_options(scaling: float, tight: float, first: Mapping[str, Any]) -> dict[str, Any]:
    """Ipopt's options by stage: the first relaxation, those after it, the exact finish.

    Each stage begins with the multipliers and about the barrier that the one before ended with, so that Ipopt
    goes on and does not centre anew. ``scaling`` is the factor of the objective: for the energy it brings the
    mean gradient in the outer variables to a third (:func:`formulations.joint.pull`), since Ipopt's barrier
    and tolerances are absolute. ``first`` are further options of the first stage.
    """
    common = {**COMMON, "obj_scaling_factor": scaling}
    return {
        "ipopt_relaxed": {**common, "bound_mult_init_method": "mu-based", "tol": LOOSE, **first},
        "ipopt_warm": {"mu_strategy": "monotone", "mu_init": LOOSE / 100, "tol": BETWEEN},
        "ipopt_exact": {
            **common,
            "mu_init": tight,
            "tol": tight,
            # with 1e-7 objectives other than the energy were left with rates of descent of 3e-4
            "acceptable_tol": ACCEPTABLE * (tight / TIGHT),
        },
    }


def after_energy(scaling: float) -> dict[str, Any]:
    """Options from the minimiser of the energy NLP, or another formulation's, on.

    With the objective scaled and the barrier left about where that NLP left them, each slack times its
    multiplier is still the barrier: Ipopt goes on as if it had been given the multipliers.
    """
    ipopt = {
        "tol": 1e-8,
        "obj_scaling_factor": scaling,
        "bound_mult_init_method": "mu-based",
        "mu_strategy": "monotone",
        "mu_init": BARRIER_AFTER,
        **dict.fromkeys(PUSHES, 1e-13),
    }
    # many move limits are weakly active: an interior point meets those only to the root of its tolerance
    exact = {**ipopt, "tol": 1e-11, "acceptable_tol": ACCEPTABLE}
    return {**AFTER, "ipopt_relaxed": ipopt, "ipopt_exact": exact}


SECOND = 3
"""Most iterations of the second path, in units of the first's.

On 50 random design problems from two starts each the best of all ends is reached on 39 by the first path
alone, on 43, 46, 47, 47 and 50 with a second one of at most 1, 2, 3, 4 and any times its iterations. Without
a limit the second took 50 times the time of the first on the page on identification, to the same end."""

LIMITS = (Status.TIME_LIMIT, Status.ITERATION_LIMIT)
"""Ends of a homotopy whose last point need not be complementary."""


def build(problem: ContactProblem, objective: str | Objective = "energy") -> MPCC:
    """The symbolic MPCC, see :mod:`rmesh_nlp.models.kkt_model`; in N/m, m and the objective's unit."""
    return bilevel(problem, parse_objective(objective)).mpcc


@dataclass(frozen=True)
class RelaxationName(Part):
    """The relaxation that was followed."""

    relaxation: str


@dataclass(frozen=True)
class Homotopy(Part):
    """The homotopy by stages, and what was found at its end: multipliers, residuals, biactive pairs."""

    stages: list[dict[str, Any]]
    label: str
    b_stationary: bool | None
    biactive: int
    biactive_nodes: list[int]
    equilibrium_multiplier: float
    constraint_violation: float
    complementarity: float
    nlp_solves: int
    rescues: int


@dataclass(frozen=True)
class AllAtOnce(Formulation):
    """Solves the MPCC by a homotopy of relaxations, and an exact finish.

    From a start that is close to a minimiser, the end of another formulation, only the last relaxation and
    the exact finish follow, which certify that end as a solution of the MPCC, or leave it. So they do from
    the start itself where the homotopy has ended at a minimiser of the energy above it.

    Attributes
    ----------
    relaxation : str
        A name in ``rmesh_nlp.mpcc.RELAXATIONS``.
    options : mapping
        Fields of :class:`rmesh_nlp.mpcc.Options`, on top of ``formulations.mpcc.OPTIONS``.
    twice : bool or None
        Follow a second path from the start, of the last relaxation alone, and keep the better end; None, the
        default: where there are design variables. The two often end at different minima. The second is left
        after ``SECOND`` times the iterations of the first.
    """

    relaxation: str = "scholtes"
    options: Annotated[Mapping[str, Any], Open(Options, OF_ALL_SOLVES)] = field(default_factory=dict)
    twice: bool | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.relaxation not in RELAXATIONS:
            raise unknown("relaxation", self.relaxation, RELAXATIONS)
        Options(**{**OPTIONS, **self.options})

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        before = monitor.budget.iterations
        first = self._path(outer, q, monitor)
        twice = bool(outer.problem.design) if self.twice is None else self.twice
        if not twice or outer.is_near or outer.objective.is_energy:
            return first
        most = SECOND * (monitor.budget.iterations - before)
        second = monitor.attempt(lambda: self._path(outer.near(), q, monitor, most))
        if second is not None and second.status not in LIMITS and _rank(second) < _rank(first):
            return second
        if outer.is_valid(first.q):
            monitor.track(outer).exact(0, first.q)  # the history ends where the solve does
        return first

    def _path(self, outer: Outer, q: Array, monitor: Monitor, most: int | None = None) -> Outcome:
        point, is_energy = outer.energy(q), outer.objective.is_energy
        with monitor.budget.during("build"):
            at_start = not np.any(q)
            program = outer.kkt if at_start else in_units_of(outer.discretisation, outer.objective, point)
        track = monitor.track(outer, program.value)
        if is_energy:
            track.state_residual = lambda x: outer.residual.of_state(*_state(program, x))
        x, near = program.point(point), outer.is_near
        own = _options(outer, program.value / pull(point.gradient), near)
        with monitor.budget.during("build"):
            options = {"relaxation": self.relaxation, **OPTIONS, **own, **self.options}
            solver = MPCCSolver(program.mpcc, **options)
        result = solver(x, on_iteration=track.iterate, budget=monitor.budget.share(most))
        monitor.work += Work(kkt_factorisations=track.iterations)
        monitor.budget.check()
        relaxation = RelaxationName(self.relaxation)
        if result.status in (*LIMITS, Status.INFEASIBLE):
            return Outcome(outer, track.best(q), result.status, label="", details=(relaxation,))
        end = _equilibrium(outer, program, result)
        if is_energy and not near and is_above(end.energy, point.value):
            return self._path(outer.near(), q, monitor)
        return Outcome(
            outer,
            outer.clipped(program.split(result.x)[0]),
            result.status,
            own=end,
            label=result.stationarity,
            details=(relaxation, _figures(outer, program, result)),
        )


def _rank(end: Outcome) -> tuple[float, bool, float]:
    """Ends that obey the constraints before others, then stationary ones, then by the objective."""
    if not end.outer.is_valid(end.q):
        return np.inf, True, np.inf
    point = end.outer.function(end.q)
    violation, value = end.outer.merit(point)
    return violation, not is_stationary(end.outer, point), value


def _options(outer: Outer, scaling: float, near: bool) -> Mapping[str, Any]:
    """Options on top of ``OPTIONS``; ``scaling`` is that of the energy, ``near`` a start near a minimiser."""
    if not outer.objective.is_energy:
        stages = homotopy_options(1.0, TIGHT_OTHERS, {})
        return (
            {**AFTER, "ipopt_exact": stages["ipopt_exact"]} if near else {**stages, "factor": FACTOR_OTHERS}
        )
    if near:
        return after_energy(scaling)
    return homotopy_options(scaling, TIGHT, CENTRED if outer.has_limits else {})


def _state(program: Bilevel, x: Array) -> tuple[Array, Array, Array, Array]:
    """Outer variables, displacement, and normal and tangential forces where there is friction."""
    q, u, normal, tangential = program.split(x)
    return q, u, normal, tangential[program.friction_rows]


STAGE = ("phase", "t", "product", "biactive", "multiplier", "iterations", "seconds")


def _figures(outer: Outer, program: Bilevel, result: MPCCResult) -> Homotopy:
    return Homotopy(
        stages=[
            {**{name: getattr(stage, name) for name in STAGE}, "status": stage.status.value}
            for stage in result.history
        ],
        label=result.label,
        b_stationary=result.b_stationary,
        biactive=int(result.biactive.size),
        biactive_nodes=np.unique(outer.contact.contact_nodes[program.pair_rows(result.biactive)]).tolist(),
        equilibrium_multiplier=float(np.max(np.abs(result.lam_g[: program.n_u]))),
        constraint_violation=result.constraint_violation,
        complementarity=result.complementarity,
        nlp_solves=result.counts["nlp_solves"],
        rescues=result.counts["rescues"],
    )


def _equilibrium(outer: Outer, program: Bilevel, result: MPCCResult) -> Equilibrium:
    """The MPCC's own displacement and forces, to be audited as they are."""
    q, u, normal, tangential = program.split(result.x)
    system = outer.contact.system_at(q)
    slip = system.tangents @ u if system.slip_bound.size else np.zeros(0)
    active = ActiveSet(normal > 0, np.sign(slip).astype(np.int8))
    return Equilibrium(u, system.energy(u), normal, tangential, active, result.status, 0)
