"""From the last node positions of a strategy to a judged Solution; the same for all strategies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from rmesh_nlp.assessment.assessor import Assessor
from rmesh_nlp.assessment.quantities import quantities
from rmesh_nlp.assessment.verdict import Measured, verdict
from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.contact.system import Equilibrium
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.discretisation.validity import is_valid, least_area_ratio
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.contact_terms import nodal_weights
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.fem.objectives import ENERGY
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.problem.checks import check_unknowns
from rmesh_nlp.programs.energy_program import Relocation, relocation
from rmesh_nlp.programs.multipliers import multipliers
from rmesh_nlp.programs.outer_function import Reduced, outer_function
from rmesh_nlp.programs.reduced import ReducedEnergy
from rmesh_nlp.programs.residual import OuterResidual, size_of
from rmesh_nlp.solving.clock import Clock, timed
from rmesh_nlp.solving.findings import (
    decrease_of,
    first_fault,
    nodal_stress,
    residuals,
    warnings_of,
    without_solution,
    zones,
)
from rmesh_nlp.solving.interrupts import deferred
from rmesh_nlp.solving.solution import Solution, interrupted
from rmesh_nlp.solving.step import Step

OnStep = Callable[[Step], None]
"""Called after each iteration of a strategy, for progress."""

ENERGY_AGREEMENT = 1e-6
"""Largest relative difference between a solver's energy and the exact contact solve."""

PROVED = ("S", "B")
"""Labels of an MPCC that prove first-order optimality where strict complementarity fails, and with it the
gradient of an objective other than the energy."""

STATIONARY = 1e-6
"""Default of ``tolerance`` in every strategy: the largest first-order residual of a stationary point."""


class Referee:
    """Holds what every strategy shares for one problem, and judges what it ends with.

    Attributes
    ----------
    problem : ContactProblem
    discretisation : Discretisation
        Its fields, element terms and validity rows, for all programs of the strategy.
    model : ContactModel
        Contact solves with the problem's own quadrature.
    relocation : Relocation
        With the objective, if the levels collapse for it, else with the energy.
    reduced : ReducedEnergy
    initial : Equilibrium
        Contact solution on the initial mesh.
    clock : Clock
        Runs from the making of the referee on; afterwards time counts as spent on solving. A strategy
        that states programs of its own does it in ``with referee.clock.during("build")``.
    """

    def __init__(self, problem: ContactProblem, objective: str | Objective = "energy") -> None:
        self.clock = Clock()
        check_unknowns(problem)
        self.problem = problem
        self._last_function: tuple[str | Objective, Reduced] | None = None
        self.discretisation = discretise(problem)
        self.model = ContactModel(self.discretisation)
        outer = parse_objective(objective)
        self.relocation: Relocation = relocation(self.discretisation, outer if outer.collapses else ENERGY)
        self.reduced = ReducedEnergy(self.relocation, self.model)
        with self.clock.during("audit"):
            self.initial, self._contact_time = timed(lambda: self.model.solve(np.asarray(problem.mesh.p)))
            self.assessor = Assessor(self.model, self.initial)
            self.reduced.knows(self.initial)
        self.clock.enter("solve")

    def function(self, objective: str | Objective) -> Reduced:
        """An outer objective as a function of the moves, each value an exact contact solve."""
        outer = parse_objective(objective)
        if (outer.is_energy and self.relocation.objective.is_energy) or outer == self.relocation.objective:
            return self.reduced
        if self._last_function is None or self._last_function[0] != objective:
            with self.clock.during("build"):
                self._last_function = objective, outer_function(self.reduced, outer)
        return self._last_function[1]

    def residual(self, function: Reduced) -> OuterResidual:
        """The first-order residual of an outer objective, relative to its value on the mesh as given."""
        with self.clock.during("audit"):
            system = self.model.system(self.problem.mesh.p)
            given = self.reduced.at(np.zeros(self.relocation.n_q), system, self.initial)
            return OuterResidual(
                self.reduced, given if isinstance(function, ReducedEnergy) else function.of(given)
            )

    def start(self, seed: int | None, positions: Array | None = None) -> Array:
        """Moves to start from: none, or drawn uniformly from the boxes with a seed.

        With ``positions`` (2, nodes), say prolonged from a coarser mesh, the moves that lead
        there, cut to the boxes; a seed then has no effect. Without boxes a draw moves nodes by
        up to their shortest edge. Moves that break element validity are halved until they do not.
        """
        free = self.relocation.freedoms
        if positions is not None:
            q = np.clip(free.q_of(positions), -free.bound, free.bound)
        elif seed is not None:
            q = np.random.default_rng(seed).uniform(-1, 1, free.n)
        else:
            return np.zeros(free.n)
        # close to positions that were asked for, a draw may shrink faster
        factor = 0.5 if positions is None else 0.95
        while not self.is_valid(q):
            q = factor * q
        return q

    def is_valid(self, q: Array) -> bool:
        """Whether all elements are valid at moves ``q``, see :mod:`rmesh_nlp.discretisation.validity`."""
        barrier = self.relocation.objective.has_barrier
        return is_valid(self.problem, self.relocation.nodes(q), by_barrier=barrier)

    def judge(
        self,
        formulation: str,
        q: Array,
        *,
        status: Status,
        history: list[Step],
        iterations: int,
        contact_solves: int,
        objective: str | Objective = "energy",
        start: str = "given",
        settings: Mapping[str, Any] | None = None,
        tolerance: float = STATIONARY,
        claimed_energy: float | None = None,
        equilibrium: Equilibrium | None = None,
        stationarity: str | None = None,
        seed: int | None = None,
        extra: dict[str, Any] | None = None,
        relocates: bool = True,
        own: Equilibrium | None = None,
    ) -> Solution:
        """Solve the contact problem at ``q``, audit it, and decide on success.

        Parameters
        ----------
        start : str
            Where the strategy started, for the record.
        settings : mapping, optional
            Settings that differ from the defaults, for the record.
        tolerance : float
            Largest first-order residual of a point that is called stationary.
        claimed_energy : float, optional
            What the strategy says the energy is; a disagreement with the contact solve by
            more than 1e-6 relative makes the status INACCURATE.
        equilibrium : Equilibrium, optional
            The strategy's own displacement and forces, which are then what is audited and
            returned, instead of the contact solve.
        own : Equilibrium, optional
            The strategy's own displacement and forces where the contact solve replaces them in the
            solution: their residuals are recorded beside the referee's.
        relocates : bool
            Whether the strategy moves nodes at all; if not, there is nothing to be stationary in.
        stationarity : str, optional
            Label computed by the strategy; by default "KKT" if the measured residual allows.
        """
        with self.clock.during("audit"), deferred() as stopped:
            draft = self._judged(
                formulation,
                q,
                status=status,
                objective=objective,
                tolerance=tolerance,
                claimed_energy=claimed_energy,
                equilibrium=equilibrium,
                stationarity=stationarity,
                relocates=relocates,
                own=own,
                history=tuple(history),
                iterations=iterations,
                contact_solves=contact_solves,
                start=start,
                seed=seed,
                settings=dict(settings or {}),
                extra=extra or {},
            )
        if stopped() or status is Status.INTERRUPTED:  # what comes next must not begin, whatever the verdict
            draft = interrupted(draft)
        return replace(
            draft,
            build_time_s=self.clock.seconds("build"),
            solve_time_s=self.clock.seconds("solve"),
            audit_time_s=self.clock.seconds("audit"),
        )

    def _judged(
        self,
        formulation: str,
        q: Array,
        *,
        status: Status,
        objective: str | Objective,
        tolerance: float,
        claimed_energy: float | None,
        equilibrium: Equilibrium | None,
        stationarity: str | None,
        relocates: bool,
        own: Equilibrium | None,
        **common: Any,
    ) -> Solution:
        nodes = self.relocation.nodes(q)
        start = self.assessor.initial
        common.update(
            problem=self.problem,
            formulation=formulation,
            objective=str(objective),
            mesh=relocated_mesh(self.problem.mesh, nodes),
            energy_initial=self.initial.energy,
            energy_initial_audited=start.energy,
            contact_time_s=self._contact_time,
        )
        ratio = least_area_ratio(self.problem, nodes)
        if not ratio > 0:
            return without_solution(common, self.problem, ratio, status)
        cold, factorisations = self.reduced.cold_solves, self.reduced.factorisations
        exact = self.reduced(q)
        after = self.assessor.solve(nodes, exact.equilibrium.active)
        found = equilibrium or exact.equilibrium
        audit = self.assessor.audit(nodes, found, after)
        corrections = self.assessor.corrections(nodes, found, after)
        function = self.function(objective)
        point = exact if isinstance(function, ReducedEnergy) else function.of(exact)
        residual = self.residual(function)(point)
        labelled = stationarity in PROVED and bool(np.any(point.weak))
        ends = (
            (one.energy, one.state if one.problem is self.problem else own_state)
            for one, own_state in ((start, self.initial), (after, exact.equilibrium))
        )
        decrease, size = decrease_of(self.reduced, function, objective, q, *ends)
        if function is self.reduced and size_of(point) > 0:
            size = max(size, size_of(point))
        claimed, expected = claimed_energy, exact.value
        if equilibrium is not None:
            claimed, expected = found.energy, exact.equilibrium.energy
        measured = Measured(
            audit=audit,
            contact=first_fault(self.initial.status, start.status, exact.equilibrium.status, after.status),
            consistent=claimed is None
            or abs(claimed - expected) <= ENERGY_AGREEMENT * size_of(exact)
            or size_of(exact) == 0,
            gain=self.initial.energy - found.energy,
            gain_audited=start.energy - after.energy,
            decrease=decrease,
            size=size,
            is_energy=function is self.reduced,
            stationary=residual <= tolerance or labelled or not relocates,
            corrections={
                name: value - self.assessor.initial_corrections[name] for name, value in corrections.items()
            },
        )
        judged = verdict(status, measured)
        detail = _EXPLOITED[measured.exploits] if judged.status is Status.EXPLOITED else ""
        if stationarity is None:
            stationarity = "KKT" if residual <= tolerance else ""
        weights = nodal_weights(self.problem, nodes)
        common["extra"] = {
            **common["extra"],
            "tolerance": tolerance,
            "cold_contact_solves": min(cold, common["contact_solves"]) if relocates else 1,
            "contact_factorisations": factorisations if relocates else self.initial.iterations,
            **residuals(self.model.system(nodes), own or found, exact.equilibrium),
            **zones(self.problem, exact.equilibrium),
            "exploits": measured.exploits or None,
            **self._quantities(nodes, found),
            "warnings": warnings_of(self.model, self.initial, self._accurate_load, nodes, found),
        }
        if self.problem.motion.curves:
            areas = (signed_areas(x, self.problem.triangles).sum() for x in (nodes, self.problem.mesh.p))
            common["extra"]["domain_area_change"] = next(areas) / next(areas) - 1
        return Solution(
            **common,
            displacement=self.model.displacement.values(found.u),
            pressure=nodal_stress(self.model, found.normal_force, weights),
            tangential_stress=nodal_stress(self.model, found.tangential_force, weights),
            energy=found.energy,
            audit=audit,
            status=judged.status,
            valid=judged.valid,
            improved=judged.improved,
            success=judged.success,
            stationarity=stationarity,
            stationarity_residual=residual,
            multipliers=multipliers(self.reduced, q, point.gradient),
            detail=detail,
            solver_status=status,
            measured=measured,
            assessed=(start, after),
        )

    def _quantities(self, nodes: Array, found: Equilibrium) -> dict[str, float]:
        """Record entries: pressure, resultant and contact before and after."""
        given, entries = np.asarray(self.problem.mesh.p), {}
        for suffix, where, state in (("_initial", given, self.initial), ("", nodes, found)):
            here = quantities(self.problem, where, self.model.system(where), state)
            if here is not None:
                entries.update(here.entries(suffix))
        return entries

    @cached_property
    def _accurate_load(self) -> Array | None:
        """Nodal loads on the mesh as given, by an accurate rule; None if it had to be refined."""
        start = self.assessor.initial
        return start.system.load if start.problem is self.problem else None


_EXPLOITED = {
    "quadrature": "The rule for the loads is too coarse: take a higher degree.",
    "penetration": "Between its nodes the contact boundary passes into the foundation: take gap = 'edge'.",
    "friction": "The friction bound varies within edges.",
    "geometry": "The edges along a curve have grown.",
    "": "",
}
"""What the message of an exploited solution adds."""
