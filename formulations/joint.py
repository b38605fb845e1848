"""All at once without complementarity: min over (X, u) of the energy.

Outer and inner objective are the same energy, so the bilevel problem collapses to one NLP.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from formulations.joint_finish import Finish, finished
from rmesh_nlp.assessment.verdict import LIMITS
from rmesh_nlp.contact.system import ActiveSet, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.optimize.solver import NLPResult, Solver
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.optimize.units import Seen, Units
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.alternating import alternated
from rmesh_nlp.programs.energy_program import Relocation, relocation
from rmesh_nlp.programs.reduced import ReducedPoint
from rmesh_nlp.settings import Count, Limit, Positive, Settings
from rmesh_nlp.solution.beginning import Start, beginning
from rmesh_nlp.solution.composed import composed
from rmesh_nlp.solution.history import TIME_LIMIT_S, Recorder
from rmesh_nlp.solution.referee import STATIONARY, OnStep, Referee
from rmesh_nlp.solution.regularised import Regularisation
from rmesh_nlp.solution.solution import Solution

ORDINARY = (1e-4, 1e4)
"""Sizes of displacements that Ipopt is given as they are; others are measured in the largest of them."""

_BARRIER: Mapping[str, Any] = {
    # Ipopt would add a factor of its own, which depends on the unit of force.
    "nlp_scaling_method": "none",
    # Start in the middle of the boxes and let the moves choose their corners as the barrier
    # falls; with a small barrier they choose too early.
    "mu_init": 2.0,
    "bound_mult_init_method": "mu-based",
    # The energy is concave in some direction at nearly every iterate, so the Hessian is shifted.
    # A shift within a factor 1.5 of the least one takes half of the steps that Ipopt's own
    # search, within a factor 8, needs, and repays the factorisations that it costs.
    "perturb_dec_fact": 0.2,
    "perturb_inc_fact": 1.5,
}


@dataclass(frozen=True)
class JointSettings(Settings):
    """Settings of ``joint``; docs/notes/speed.md has the benchmarks that chose them.

    Attributes
    ----------
    max_iterations : int
        Of Ipopt.
    tol, acceptable_tol : float
        Ipopt's tolerances where boxes alone keep the elements valid, in units of `pull`. Many boxes are
        weakly active, and an interior point meets those only to the square root of its tolerance; where
        rounding stops it before, the looser one will do.
    tol_areas, acceptable_tol_areas : float
        The same where element areas are constraints, in units of `half_energy`: in those of `pull` the
        rounding of the forces can be above every tolerance, and Ipopt's restoration then leaves the
        minimiser and ends as infeasible (6.2 on 36 x 18 squares).
    first_barrier : float
        Ipopt's first barrier where a distortion keeps the elements valid, in units of `half_energy`. With its
        own one, 0.1, the first steps leave the start, which with a schedule of weights is the minimiser for
        the last weight. Of 0.1, 1e-2, 1e-3, 1e-4 and 1e-6 it was chosen on random
        problems without boxes.
    fine : int
        Number of moves from which on the start is given alternating moves
        (:mod:`rmesh_nlp.programs.alternating`): the end is then lower by 0.1 to 0.7 % of the gain (6.1 with
        32 to 128 squares a side). On coarser meshes they change nothing but the start.
    alternating : float
        Length of these moves, in boxes.
    ipopt : mapping
        Further Ipopt options, which override all others.
    """

    max_iterations: Limit = 3000
    tol: Positive = 1e-10
    acceptable_tol: Positive = 1e-7
    tol_areas: Positive = 1e-12
    acceptable_tol_areas: Positive = 1e-9
    first_barrier: Positive = 1e-3
    fine: Count = 3000
    alternating: Positive = 0.3
    ipopt: Mapping[str, Any] = field(default_factory=dict)

    def options(self, areas: bool, unit: float, distorted: bool = False) -> dict[str, Any]:
        """Ipopt's options, the objective in units of ``unit``, ``areas`` as constraints or without.

        ``distorted`` says that the objective has a distortion, which stands in the place of areas.
        """
        common = {"max_iter": self.max_iterations, "obj_scaling_factor": 1 / unit}
        if areas:
            own = {
                "nlp_scaling_method": "none",
                "tol": self.tol_areas,
                "compl_inf_tol": self.tol_areas,
                "acceptable_tol": self.acceptable_tol_areas,
            }
            if distorted:
                own["mu_init"] = self.first_barrier
        else:
            own = {**_BARRIER, "tol": self.tol, "acceptable_tol": self.acceptable_tol}
        return {**common, **own, **self.ipopt}


def build(problem: ContactProblem) -> NLP:
    """The symbolic NLP in ``x = (q, u, s)``, see :mod:`rmesh_nlp.programs.energy_program`.

    Extend it with :meth:`rmesh_nlp.optimize.nlp.NLP.extended`, or hand ``x``, ``f`` and ``g`` to any
    CasADi solver.
    """
    return relocation(problem).nlp


@composed
def solve(
    problem: ContactProblem,
    *,
    objective: str | Objective = "energy",
    regularisation: Regularisation = None,
    distortion: str = "shape-size",
    flips: bool = False,
    settings: JointSettings | Mapping[str, Any] | None = None,
    tolerance: float = STATIONARY,
    max_iterations: int | None = None,
    time_limit_s: float = TIME_LIMIT_S,
    start: Start = None,
    seed: int | None = None,
    on_step: OnStep | None = None,
) -> Solution:
    """Minimise the energy over node positions and displacement together, by Ipopt.

    Where Ipopt stops close to a stationary point but not at one, Newton steps on the reduced energy follow;
    the record then has their number as ``newton_steps``.

    Parameters
    ----------
    problem : ContactProblem
    objective : str or Objective
        The energy, or the energy and terms in the positions alone such as "energy + 0.01*quality": with any
        other outer objective the levels do not collapse.
    regularisation : float or sequence of float, optional
        Weight of a distortion that is added to the energy, relative to the error of the energy on the mesh as
        given, or a schedule of weights of which the last may be 0; 0.01 suits most problems without boxes.
    distortion : str
        "quality", "shape-size" or "elastic", see :mod:`rmesh_nlp.fem.distortion`.
    flips : bool
        Flip edges by energy between relocations, until neither gains; without boxes only.
    settings : JointSettings or mapping, optional
    tolerance : float
        Largest first-order residual, measured by the referee, of a solution that is called converged.
    max_iterations : int, optional
        In place of that of the settings.
    time_limit_s : float
        After it, as after Ctrl-C, the best valid mesh so far is the solution.
    start : positions (2, nodes), "given", name of a strategy, or Solution, optional
        See :func:`rmesh_nlp.solution.beginning.beginning`.
    seed : int, optional
        Random start; by default the initial mesh.
    on_step : callable, optional
        Called after each Ipopt iteration.

    Raises
    ------
    ValueError
        If the levels do not collapse for the objective, or a setting or the start cannot be used.
    """
    outer = parse_objective(objective)
    if not outer.collapses:
        raise ValueError(
            f"joint minimises the energy only, or with terms in the positions, not {outer.text!r}: with "
            "another outer objective the inner problem must stay a constraint; use mpcc or nested"
        )
    chosen = JointSettings.of(settings)
    if max_iterations is not None:
        chosen = replace(chosen, max_iterations=max_iterations)
    referee = Referee(problem, outer)
    begin = beginning(referee, start, seed, time_limit_s=time_limit_s)
    recorder = Recorder(referee, on_step, time_limit_s, is_energy=outer.is_energy)
    result = recorder.run(lambda: minimise(referee, begin.q, recorder, chosen))
    if result is None or recorder.stopped is not None:
        q, claimed = recorder.best(referee.reduced, begin.q), None
    else:
        bound = referee.relocation.freedoms.bound
        q, claimed = np.clip(result.x[: bound.size], -bound, bound), result.f  # it may leave them by 2e-12
        if not result.converged and not referee.is_valid(q):  # elements may be inverted
            q, claimed = recorder.best(referee.reduced, begin.q), None
    said, steps = recorder.status(result), recorder.steps(result)
    own = None if claimed is None or result is None else _own(referee, q, result)
    factorisations = max(len(steps) - 1, 0)
    finish = Finish(q, 0, 0)
    if said not in LIMITS or said is Status.STALLED:
        finish = finished(referee, q, factorisations, recorder, tolerance)
        steps += recorder.steps()
    if finish.q is not q:
        claimed = own = None
    return referee.judge(
        "joint",
        finish.q,
        status=said,
        tolerance=tolerance,
        history=steps,
        iterations=begin.iterations + factorisations + finish.iterations,
        contact_solves=begin.contact_solves + 1 + finish.contact_solves,
        objective=objective,
        claimed_energy=claimed,
        own=own,
        start=begin.name,
        seed=seed,
        settings=chosen.changed(),
        extra={
            "kkt_factorisations": factorisations,
            **({"newton_steps": finish.iterations} if finish.iterations else {}),
            **_outer_values(referee, finish.q),
        },
    )


def _outer_values(referee: Referee, q: Array) -> dict[str, float]:
    """Record entries of the outer objective before and after; of a mesh that is not valid none."""
    if not referee.is_valid(q):
        return {}
    start, end = referee.reduced(np.zeros(q.size)), referee.reduced(q)
    return {"objective_initial": start.value, "objective_value": end.value}


def _own(referee: Referee, q: Array, result: NLPResult) -> Equilibrium:
    """The program's own displacement, and contact forces: the multipliers of its gaps and slips."""
    rel = referee.relocation
    _, u, _ = rel.split(result.x)
    n, n_s = rel.n_contact, rel.friction_rows.size
    forces = -result.lam_g[: n + 2 * n_s]  # CasADi's multiplier of an active lower bound is negative
    tangential = np.zeros(n if n_s else 0)
    tangential[rel.friction_rows] = forces[n + n_s :] - forces[n : n + n_s]
    active = ActiveSet(forces[:n] > 0, np.sign(tangential).astype(np.int8))
    system = referee.model.system(rel.nodes(q))
    return Equilibrium(u, system.energy(u), forces[:n], tangential, active, Status.CONVERGED, 0)


def minimise(
    referee: Referee, q: Array, recorder: Recorder, settings: JointSettings | None = None
) -> NLPResult:
    """Solve the energy program from moves ``q`` and the contact solution there."""
    contact, relocation, settings = referee.reduced(q), referee.relocation, settings or JointSettings()
    distorted = relocation.objective.has_barrier
    areas = relocation.n_valid > 0 or distorted
    if not areas and relocation.n_q >= settings.fine:
        q = alternated(relocation, q, contact.gradient, settings.alternating, referee.is_valid)
        unit = pull(contact.gradient)
        contact = referee.reduced(q)
    else:
        unit = half_energy(contact) if areas else pull(contact.gradient)
    units = _units(relocation, contact)
    with referee.clock.during("build"):
        nlp = relocation.nlp if units is None else units.program(relocation.nlp)
        monitor = recorder if units is None else Seen(units, recorder, recorder.see_multipliers)
        solver = Solver(nlp, options=settings.options(areas, unit, distorted), monitor=monitor)
    recorder.residual = referee.residual(referee.reduced).of_program
    begin = referee.reduced.point(q, contact.equilibrium)
    try:
        return solver(begin) if units is None else units.result(solver(begin / units.x))
    finally:
        recorder.residual = None  # it may go on to watch another program


def _units(relocation: Relocation, contact: ReducedPoint) -> Units | None:
    """Units of displacements and gaps if theirs are far from one, as Ipopt's tolerances are absolute."""
    length = float(np.max(np.abs(contact.equilibrium.u)))
    if length == 0 or ORDINARY[0] <= length <= ORDINARY[1]:
        return None
    lengths, rows = relocation.n_u + relocation.n_s, relocation.n_rows - relocation.n_valid
    return Units(
        np.append(np.ones(relocation.n_q), np.full(lengths, length)),
        np.append(np.full(rows, length), np.ones(relocation.n_valid)),
    )


def pull(gradient: Array) -> float:
    """The unit of the objective in which a barrier of order one suits the moves.

    Three times the mean of the gradient in the moves; 1 where nothing pulls. For the energy it
    falls like the gain per node, by a factor near 20 with every halving of the mesh size, while
    Ipopt's barrier and tolerances are absolute.
    """
    return 3 * float(np.mean(np.abs(gradient))) if np.any(gradient) else 1.0


def half_energy(point: ReducedPoint) -> float:
    """Half the size of the energies in a contact solution, which may cancel in their sum; 1 where all vanish.

    Ipopt's tolerances and barrier are absolute. Of 1, 2, 5 and 10 parts of the energy two gave the
    least iterations and energies on the examples and the gallery.
    """
    u = point.equilibrium.u
    return 0.5 * max(abs(point.value), 0.5 * float(u @ (point.system.stiffness @ u))) or 1.0
