"""What the contact carries: forces, peak pressure and length, by contact boundary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.evaluation import ROUNDING, Array
from rmesh_nlp.fem.contact_pressure import ContactStress, recovered
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.geometry import angles
from rmesh_nlp.problem.coefficients import as_function, evaluated
from rmesh_nlp.problem.data import ContactSet

CLEAR = 0.01
"""Part of a result below which it got no worse, and of the contact force below which a residual of Coulomb's
law is small: with edges of a tenth of the contact's length, solutions that partly stick have 5e-4 to 8e-3."""


PEAKED = 1.1
"""Least ratio of a peak at the end of a contact boundary, or at a kink, to the pressure beside it of which is
said that it may have no limit."""


@dataclass(frozen=True)
class ContactResult:
    """Results of a contact boundary, per unit of depth or of the whole revolution.

    Attributes
    ----------
    normal_force : float
        Integral of the contact pressure, in N/m.
    tangential_force : float
        Sum of the friction on the body along the tangents, in N/m.
    peak_pressure : float
        Largest value of the recovered pressure, in N/m^2.
    contact_length : float
        Of the boundary where it presses, in m; of an interior obstacle an area.
    force_x, force_y : float or None
        Force of the foundation on the body, pressure and friction, in N/m; None for a scalar problem.
    moment : float or None
        Of that force about the origin, in N, positive counter-clockwise.
    """

    normal_force: float
    tangential_force: float
    peak_pressure: float
    contact_length: float
    force_x: float | None = None
    force_y: float | None = None
    moment: float | None = None


def contact_results(
    space: DisplacementSpace, nodes: Array, system: ContactSystem, state: Equilibrium
) -> dict[str, ContactResult]:
    """The results of a contact solution at vertex positions (2, vertices), by contact boundary.

    Foundations after the first one on the same boundary have their number behind its name.
    """
    results = dict[str, ContactResult]()
    if not state.normal_force.size:
        return results
    least = ROUNDING * max(system.force_scale, np.max(state.normal_force))
    for part in space.contact_sets:
        name = str(part.obstacle.boundary)
        if name in results:
            name = f"{name} {part.number + 1}"
        pressure, friction = recovered(space, nodes, part, state.normal_force, state.tangential_force)
        normal, along = float(np.sum(pressure.nodal)), float(np.sum(friction.nodal))
        results[name] = ContactResult(
            normal_force=normal,
            tangential_force=along if abs(along) > ROUNDING * normal else 0.0,
            peak_pressure=float(np.max(pressure.values)),
            contact_length=pressure.length(least),
            **_vector(nodes, pressure, friction),
        )
    return results


def _vector(nodes: Array, pressure: ContactStress, friction: ContactStress) -> dict[str, float]:
    """Force and moment of the forces at nodes; none of a scalar problem."""
    space, totals, obstacle = pressure.space, np.zeros(3), pressure.part.obstacle
    if space.problem.components == 1:
        return {}
    acting = np.flatnonzero((pressure.nodal != 0) | (friction.nodal != 0))
    for which, vertices, _ in space.kinds(acting):
        own = acting[which]
        places = space.places(obstacle, own, vertices)
        n_x, n_y = space.normals(obstacle, nodes, places)
        f_x, f_y = pressure.nodal[own] * (n_x, n_y) + friction.nodal[own] * (n_y, -n_x)
        x, y = space.points(nodes)[:, places]
        totals += [np.sum(values) for values in (f_x, f_y, x * f_y - y * f_x)]
    if space.problem.axisymmetric:
        totals[::2] = 0.0  # they cancel around the axis
    return dict(zip(("force_x", "force_y", "moment"), totals.tolist(), strict=True))


def unlimited_peaks(space: DisplacementSpace, nodes: Array, state: Equilibrium) -> dict[str, str]:
    """A sentence for each peak of the pressure, well above its neighbours, that may have no limit.

    By its boundary.
    """
    said = dict[str, str]()
    for part in space.contact_sets:
        (on,) = recovered(space, nodes, part, state.normal_force)
        pressure = on.values[: space.n_vertices]
        top = int(np.argmax(pressure))
        beside = np.setdiff1d(on.cells[:, np.any(on.cells == top, axis=0)], top)
        # from each of them to as far beyond the peak: most of all bending is at a kink
        at = nodes[:, [[top]]]
        lines = at + np.linspace(-1, 1, 130)[:, None] * (nodes[:, None, beside] - at)
        (gaps,) = evaluated(as_function(part.obstacle.offset), lines)
        bends = np.diff(gaps, 2, axis=0)
        is_kink = np.any(bends > 0.4 * np.sum(np.abs(bends), axis=0) + ROUNDING * np.ptp(gaps, axis=0))
        is_end = on.ends[top] and not on.even_ends[top] and not _is_sharp(space, part, nodes, top)
        # between two nodes a kink lifts both
        least = np.min if is_kink else np.max
        is_peak = pressure[top] > PEAKED * least(pressure[beside], initial=pressure[top] * is_kink)
        if is_peak and (is_kink or is_end):
            place = "a kink of the foundation of" if is_kink else "the end of the contact boundary"
            name = str(part.obstacle.boundary)
            said[name] = (
                f"the largest pressure is at {place} {name!r}, where it may have no limit: it can grow "
                "with each refinement"
            )
    return said


def _is_sharp(space: DisplacementSpace, part: ContactSet, nodes: Array, vertex: int) -> bool:
    """Whether a vertex is a corner of the body of up to 90 degrees without friction, or of a membrane.

    Mirrored in the foundation it is one of up to 180 degrees without load, at which no stress is singular.
    """
    if part.obstacle.friction_law:
        return False
    triangles = space.problem.triangles
    own = triangles[:, np.any(triangles == vertex, axis=0)]
    return bool(np.sum(angles(nodes, own)[own == vertex]) <= np.pi / 2 + ROUNDING)


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
