"""What users of a contact solution read beside the energy: largest pressure, resultant, length of contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.contact_terms import nodal_weights
from rmesh_nlp.problem import ContactProblem

CLEAR = 0.01
"""Part of a quantity below which it got no worse."""


@dataclass(frozen=True)
class Quantities:
    """Quantities of a contact solution.

    Attributes
    ----------
    peak_pressure : float
        Largest nodal force over the share omega_i of its node, in N/m^2.
    resultant : float
        Size of the sum of all contact forces on the body, friction included, in N/m.
    contact_length : float
        Length of the contact boundary at nodes that press on the foundation (an area for an obstacle in the
        interior), in m.
    """

    peak_pressure: float
    resultant: float
    contact_length: float

    def entries(self, suffix: str = "") -> dict[str, float]:
        """Entries of a record."""
        return {f"{name}{suffix}": value for name, value in vars(self).items()}


def quantities(
    problem: ContactProblem, nodes: Array, system: ContactSystem, state: Equilibrium
) -> Quantities | None:
    """The quantities of a contact solution at node positions (2, nodes); None without contact."""
    force = state.normal_force
    if not force.size:
        return None
    weights = nodal_weights(problem, nodes)
    normals, tangents = directions(problem, nodes)
    total = normals @ force
    if state.tangential_force.size:
        total = total + tangents @ state.tangential_force
    pressing = force > 1e-9 * max(system.force_scale, float(np.max(force)))
    return Quantities(
        peak_pressure=float(np.max(force / weights)),
        resultant=float(np.linalg.norm(total)),
        contact_length=float(np.sum(weights[pressing])),
    )


def directions(problem: ContactProblem, nodes: Array) -> tuple[Array, Array]:
    """Normals and tangents (components, gaps) at contact nodes."""
    parts = [part.obstacle.normals(nodes[:, part.nodes]) for part in problem.contact_sets]
    normals = np.hstack([np.zeros((problem.components, 0)), *parts])
    return normals, np.stack([normals[1], -normals[0]]) if problem.components == 2 else normals


def worse(before: Quantities, after: Quantities, refined: Quantities) -> list[str]:
    """A sentence for each quantity that is farther from its value on a refined mesh than before."""
    found = []
    names = {
        "peak_pressure": "largest pressure",
        "resultant": "resultant",
        "contact_length": "length of contact",
    }
    for name, label in names.items():
        one, two, true = (float(getattr(part, name)) for part in (before, after, refined))
        if abs(two - true) > abs(one - true) + CLEAR * abs(true):
            found.append(
                f"the {label} got worse while the energy got better: {one:.4g} on the given mesh, {two:.4g} "
                f"after relocation, {true:.4g} on the refined mesh"
            )
    return found
