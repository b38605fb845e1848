"""How far a contact solution is from equilibrium, the laws of contact, and the continuous problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ContactSystem, Equilibrium, OwnState
from rmesh_nlp.evaluation import Array, magnitude
from rmesh_nlp.optimize.activity import ZERO

EXPLOITS = ("quadrature", "penetration", "friction", "geometry")
"""Errors of a discretisation that an optimiser may live on."""


@dataclass(frozen=True)
class ContactResiduals:
    """How far displacements and forces are from equilibrium and from the laws of contact and friction."""

    equilibrium: float  # largest out-of-balance nodal force, relative to the largest applied one
    complementarity: float  # violation of the laws of contact and friction, dimensionless

    @property
    def hold(self) -> bool:
        """Whether both are zero up to the tolerance of gaps and forces; not if one is no number."""
        return self.equilibrium <= ZERO and self.complementarity <= ZERO


def corrections(
    model: ContactSolver, nodes: Array, solved: Equilibrium, exact: Admissible
) -> dict[str, float]:
    """What the continuous energy differs by from that of a contact solution, by what it is due to.

    Quadrature of the loads, and friction lumped at nodes: the mean difference of their work and its energy at
    the two displacements. The shape of the body: that of the strain energies at the admissible one.
    Penetration between nodes: what is left, all of it on a mesh that had to be refined.
    """
    causes, continuous = dict.fromkeys(EXPLOITS, 0.0), exact.continuous
    if exact.problem is model.problem:
        system, strain = model.system(nodes), 0.0
        for u in (solved.u, exact.state.u):
            displacement = model.displacement.values(u)
            work, lumped = model.work(nodes, u), float(system.slip_bound @ np.abs(system.tangents @ u))
            causes["quadrature"] += (work - float(continuous.load @ displacement.T.ravel())) / 2
            causes["friction"] += (continuous.friction(displacement)[0] - lumped) / 2
            strain = system.energy(u) + work - lumped
        causes["geometry"] = exact.strain - strain
    return {**causes, "penetration": exact.energy - solved.energy - sum(causes.values())}


def residuals(system: ContactSystem, state: Equilibrium | OwnState) -> ContactResiduals:
    """How far displacement and contact forces are from equilibrium and from the laws (3.10) at the nodes.

    With U the largest displacement and F the largest applied nodal force these are
    ``max |K u - F - N^T lambda - T^T tau| / F``, and the larger one of ``max |min(gap / U, lambda / F)|`` and
    ``max |tau + proj(slip F / U - tau)| / F``, the projection on [-b, b]. The last two vanish exactly where
    the laws hold, and count penetration and tension as well.
    """
    u, normal, tangential = state.u, state.normal_force, state.tangential_force
    length, force, bound = max(magnitude(u), 1e-300), system.force_scale, system.bound(normal)
    forces = system.normals.T @ normal + system.tangents.T @ tangential
    gap = system.normals @ u + system.offset
    slip = (system.tangents @ u) * force / length
    missing = tangential + np.clip(slip - tangential, -bound, bound)
    violations = np.append(np.minimum(gap / length, normal / force), missing / force)
    # not a number if one part is none
    return ContactResiduals(
        magnitude(system.stiffness @ u - system.load - forces) / force, magnitude(violations)
    )
