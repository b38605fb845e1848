"""What the contact carries: forces, peak pressure and length, by contact boundary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.evaluation import ROUNDING, Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import Place

CLEAR = 0.01
"""Part of a result below which it got no worse, and of the contact force below which a residual of Coulomb's
law is small: with edges of a tenth of the contact's length, solutions that partly stick have 5e-4 to 8e-3."""


@dataclass(frozen=True)
class ContactResult:
    """Results of a contact boundary, per unit of depth.

    Attributes
    ----------
    normal_force : float
        Integral of the contact pressure, in N/m.
    tangential_force : float
        Sum of the friction on the body along the tangents, in N/m.
    peak_pressure : float
        Largest nodal force over the share omega_i of its node, in N/m^2.
    contact_length : float
        Of the boundary at nodes that press, in m; of an interior obstacle an area.
    """

    normal_force: float
    tangential_force: float
    peak_pressure: float
    contact_length: float


def contact_results(
    space: DisplacementSpace, nodes: Array, system: ContactSystem, state: Equilibrium
) -> dict[str, ContactResult]:
    """The results of a contact solution at vertex positions (2, vertices), by contact boundary.

    Foundations after the first one on the same boundary have their number behind its name.
    """
    force, results = state.normal_force, dict[str, ContactResult]()
    friction = state.tangential_force if state.tangential_force.size else np.zeros(force.size)
    if not force.size:
        return results
    weights = space.weights(nodes)
    least = ROUNDING * max(system.force_scale, np.max(force))
    for part in space.contact_sets:
        boundary, rows = part.obstacle.boundary, part.rows
        name = boundary.value if isinstance(boundary, Place) else str(boundary)
        if name in results:
            name = f"{name} {part.number + 1}"
        pressing = force[rows] > least
        normal, along = (float(np.sum(forces[rows])) for forces in (force, friction))
        results[name] = ContactResult(
            normal_force=normal,
            tangential_force=along if abs(along) > ROUNDING * normal else 0.0,
            peak_pressure=float(np.max(force[rows] / weights[rows], initial=0.0)),
            contact_length=float(np.sum(weights[rows][pressing])),
        )
    return results


def worse(
    before: Mapping[str, ContactResult], after: Mapping[str, ContactResult], true: Mapping[str, ContactResult]
) -> list[str]:
    """A sentence for each result that is farther from its value on a refined mesh than before."""
    labels = {
        "peak_pressure": "largest pressure",
        "normal_force": "normal force",
        "contact_length": "length of contact",
    }
    sentences, places = [], before.keys() & after.keys() & true.keys()
    for name, label in labels.items():
        size = max((abs(getattr(true[place], name)) for place in places), default=0.0)
        for place in sorted(places):
            given, last, fine = (float(getattr(part[place], name)) for part in (before, after, true))
            if abs(last - fine) > abs(given - fine) + max(CLEAR * abs(fine), ROUNDING * size):
                at = f" at {place}" if len(places) > 1 else ""
                sentences.append(
                    f"the {label}{at} got worse: {given:.4g} on the given mesh, "
                    f"{last:.4g} after relocation, {fine:.4g} on the refined mesh"
                )
    return sentences
