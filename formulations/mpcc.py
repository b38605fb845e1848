"""All at once: the contact problem as KKT conditions, an MPCC in positions, displacement and forces.

The complementarity of contact and friction is relaxed with a parameter t, and t goes down from
``t0`` to the end, from the start that is given, for every outer objective. For the energy it ends
where ``joint`` does, and the multipliers of the equilibrium constraints vanish there (the term
with U' drops out, seen from the other side). It is meant for outer objectives for which the
levels do not collapse.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from formulations.finish import is_above, is_stationary
from formulations.ipopt import CENTRED, COMMON, TIGHT, exact, pull, pushed
from rmesh_nlp.contact.system import OwnState
from rmesh_nlp.evaluation import Array, is_finite, magnitude
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.kkt_model import Bilevel, bilevel, in_units_of
from rmesh_nlp.mpcc import MPCC, MPCCResult, MPCCSolver, Options
from rmesh_nlp.optimize.solver import PluginOptions
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import ByName, Open, Values
from rmesh_nlp.solving.formulation import Formulation
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Work

OPTIONS: ByName = {
    "t0": 1e-2,
    "factor": 1e-2,
    "t_final": 1e-9,
    "warm_duals": True,
    # Random positions and displacements are no start: a load that no design carries takes 3 s, 14 s with six.
    "moves": 0,
}
"""Options of :class:`rmesh_nlp.mpcc.Options` for mesh problems. t is in units of the largest displacement
on the given mesh times its largest nodal load."""

OF_ALL_SOLVES = ("starts", "seed", "time_limit_s", "max_iterations")
"""Options of :class:`rmesh_nlp.mpcc.Options` that every solve has by itself."""

SLOW: PluginOptions = {
    **CENTRED,
    "mu_linear_decrease_factor": 0.5,
    "mu_superlinear_decrease_power": 1.2,
}
"""Ipopt's barrier in the relaxations of the energy where nodes have move limits.

It begins with the nodes in the middle of their limits and falls slowly, so that the path keeps near the
central one, on which they choose their corners. Fresh random problems lose nothing without it; 6.1 with 8
squares a side then ends 0.33 % of the gain higher, and without its last entry 6.2 ends above ``joint``."""

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
    options: Annotated[ByName, Open(Options, OF_ALL_SOLVES)] = field(default_factory=dict)
    twice: bool | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        Options(**{"relaxation": self.relaxation, **OPTIONS, **self.options})

    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        before, begin = monitor.budget.iterations, len(monitor.steps)
        first = self._path(outer, q, monitor)
        twice = bool(outer.problem.design) if self.twice is None else self.twice
        if not twice or outer.is_near or outer.objective.is_energy:
            return first
        most, end = SECOND * (monitor.budget.iterations - before), len(monitor.steps)
        second = monitor.attempt(lambda: self._path(outer.near(), q, monitor, most))
        if second is not None and second.status not in LIMITS and _rank(second) < _rank(first):
            del monitor.steps[begin:end]  # the history is that of the path that is kept
            return second
        del monitor.steps[end:]
        if outer.is_valid(first.q):
            monitor.track(outer).exact(0, first.q)  # it ends where the solve does
        return first

    def _path(self, outer: Outer, q: Array, monitor: Monitor, most: int | None = None) -> Outcome:
        point, is_energy, begin = outer.energy(q), outer.objective.is_energy, len(monitor.steps)
        with monitor.budget.during("build"):
            at_start = not np.any(q)
            program = outer.kkt if at_start else in_units_of(outer.discretisation, outer.objective, point)
        track = monitor.track(outer, program.value)
        if is_energy:

            def residual(x: Array) -> float:
                at, u, normal, tangential = program.split(x)
                return outer.residual.of_state(at, u, normal, tangential[program.parts.friction_rows])

            track.residual = residual
        x = program.point(point)
        own = _options(outer, program.value / pull(outer.function(q).gradient))
        # where relocation changes the objective by little its multipliers are small in units of the model
        zero = min(Options.stationarity, outer.tolerance * outer.residual.unit / program.value)
        with monitor.budget.during("build"):
            relaxation = {"relaxation": self.relaxation}
            options = {**relaxation, "stationarity": zero, **OPTIONS, **own, **self.options}
            solver = MPCCSolver(program.mpcc, **options)
        result = solver(x, on_iteration=track.iterate, budget=monitor.budget.share(most))
        monitor.work += Work(kkt_factorisations=track.iterations)
        monitor.budget.check()
        if result.status in (*LIMITS, Status.INFEASIBLE):
            return Outcome(outer, track.best(q), result.status, label="", details=relaxation)
        end, *state = program.split(result.x)
        if is_energy and not outer.is_near:
            energy = outer.contact.system_at(end).energy(state[0])
            if is_above(energy, point.value):
                del monitor.steps[begin:]
                return self._path(outer.near(), q, monitor)
        return Outcome(
            outer,
            outer.clipped(end),
            result.status,
            own=OwnState(*state),
            label=result.stationarity,
            details={**relaxation, **_figures(outer, program, result)},
        )


def _rank(end: Outcome) -> tuple[float, bool, float]:
    """Ends that obey the constraints before others, then stationary ones, then by the objective."""
    if not end.outer.is_valid(end.q):
        return np.inf, True, np.inf
    point = end.outer.function(end.q)
    violation, value = end.outer.merit(point)
    return violation, not is_stationary(end.outer, point), value


def _options(outer: Outer, scaling: float) -> Values:
    """Options on top of ``OPTIONS``; ``scaling`` is the factor of the objective.

    It brings the mean gradient in the outer variables to a third (:func:`formulations.ipopt.pull`), since
    Ipopt's barrier and tolerances are absolute. From a start near a minimiser only the relaxation at the
    final t comes before the exact finish.
    """
    end = exact(scaling, TIGHT)
    last = {"t0": OPTIONS["t_final"], "ipopt_exact": end}
    if outer.is_near and outer.objective.is_energy:
        # with the barrier left about where the energy NLP left it, each slack times its multiplier is still
        # the barrier: Ipopt goes on as if it had been given the multipliers
        warm = {**end, "bound_mult_init_method": "mu-based", **pushed(1e-13)}
        return {**last, "ipopt_relaxed": warm, "ipopt_exact": warm}
    if outer.is_near:
        return last
    slow = SLOW if outer.objective.is_energy and is_finite(outer.discretisation.mesh_map.upper) else {}
    # a relaxed solution is only on the way: to 1e-8, as by default, it takes 1.3 times the iterations in all;
    # after the first an adaptive barrier takes 0.8 of the iterations for energies, 0.4 to 0.8 for errors
    first = {**COMMON, "obj_scaling_factor": scaling, "tol": 1e-4, **slow}
    later = {"mu_strategy": "adaptive", "tol": 1e-8}
    return {"ipopt_relaxed": first, "ipopt_warm": later, "ipopt_exact": end}


STAGE = ("phase", "t", "product", "biactive", "multiplier", "iterations", "seconds")


def _figures(outer: Outer, program: Bilevel, result: MPCCResult) -> Values:
    """Entries of the record: the homotopy by stages, and what its end is."""
    nodes = outer.contact.contact_nodes[program.pair_rows(result.biactive)]
    return {
        "stages": [
            {**{name: getattr(stage, name) for name in STAGE}, "status": stage.status.value}
            for stage in result.history
        ],
        "label": result.label,
        "b_stationary": result.b_stationary,
        "biactive": result.biactive.size,
        "biactive_nodes": np.unique(nodes).tolist(),
        "equilibrium_multiplier": magnitude(result.lam_g[: program.parts.n_u]),
        "constraint_violation": result.constraint_violation,
        "complementarity": result.complementarity,
        "nlp_solves": result.counts["nlp_solves"],
        "rescues": result.counts["rescues"],
    }
