"""Signs that a problem was set up wrongly although nothing in it contradicts itself.

What is looked at costs one contact solve on the given mesh, and one assembly of the load where it varies.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rmesh_nlp.contact.penetration import penetrations
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.edge_gaps import holds_along_edges
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.contact_problem import ContactSet
from rmesh_nlp.problem.laws import Laplace, PlaneStrain
from rmesh_nlp.problem.units import after

PENETRATION = 0.05
"""Part of the length of a contact edge that a foundation may pass into it between its nodes."""

LOCKING = 0.45
"""Poisson's ratio from which on linear triangles in plane strain are too stiff."""

LARGE = 0.1
"""Part of the extent of the body from which on displacements are not small."""

TINY = 1e-7
"""The same below which units do not fit: steel under a hundredth of its yield stress moves by 1e-5."""

FAR = 1e-3
"""A displacement over the smallest gap, below which units do not fit."""

LOAD_ERROR = 0.1
"""Relative difference of nodal loads by the problem's rule and by one of high degree."""

FEW = 3
"""Touching nodes below which a contact is not resolved, and nodes at which a boundary bends that is round."""

STRAIGHT, BEND = 1e-6, 0.7
"""Angles in radians between which a boundary bends like a curve: less is rounding, more a corner."""


@dataclass(frozen=True)
class SetupWarning:
    """One sign of a wrong set-up.

    Attributes
    ----------
    kind : str
        A short name: overlap, open, away, all-touching, unresolved, penetration, large, tiny, locking,
        load, point-load, round.
    message : str
        One sentence for people, with the figure that it rests on.
    """

    kind: str
    message: str


def setup_warnings(
    problem: ContactProblem,
    model: ContactSolver | None = None,
    state: Equilibrium | None = None,
    accurate: Array | None = None,
) -> tuple[SetupWarning, ...]:
    """All signs of a wrong set-up, from the contact solution on the given mesh.

    Parameters
    ----------
    model, state : optional
        The contact model and the solution, where they are at hand.
    accurate : (n_u,) array, optional
        Nodal loads by an accurate rule; without them the rule is not looked at.
    """
    model = model or ContactSolver(problem)
    system = model.system(problem.mesh.p)
    state = state or model.solve(problem.mesh.p)
    u = model.displacement.values(state.u)
    found = [*_materials(problem), *_loads(problem, system, accurate), *_sizes(problem, u)]
    found += _point_loads(problem)
    found += _round(problem)
    for part in problem.contact_sets:
        found += _contact(problem, part, system, state, u)
    found += penetration_warnings(problem, problem.mesh.p, u)
    return tuple(found)


def penetration_warnings(problem: ContactProblem, nodes: Array, displacement: Array) -> list[SetupWarning]:
    """Where foundations pass into the body between contact nodes, on any mesh of the problem."""
    found = []
    for part in problem.contact_sets:
        if problem.components == 1 or part.obstacle.boundary is Place.INTERIOR:
            continue  # a displacement of its own unit: there is no edge to compare with
        depth, length = penetrations(Body(problem, nodes), part.obstacle, displacement)
        ratio = depth / length
        if ratio.size and np.max(ratio) > PENETRATION:
            found.append(
                SetupWarning(
                    "penetration",
                    f"between its nodes {_name(part)} passes into the foundation by {np.max(ratio):.0%} "
                    f"of an edge (more than {PENETRATION:.0%}): refine it where the foundation is curved",
                )
            )
    return found


def _contact(
    problem: ContactProblem, part: ContactSet, system: ContactSystem, state: Equilibrium, u: Array
) -> Iterator[SetupWarning]:
    offset, touching = system.offset[part.rows], state.active.touching[part.rows]
    if holds_along_edges(problem, part.obstacle):  # nodes keep off the foundation, which is no overlap
        offset = part.obstacle.distances(problem.mesh.p[:, part.nodes])
    unit, extent = after(problem.units.length), _extent(problem)
    scale = extent if problem.components == 2 else max(float(np.max(np.abs(u))), 1e-300)
    inside = offset < -1e-9 * scale
    if np.any(inside):
        yield SetupWarning(
            "overlap",
            f"before any load the foundation overlaps the body by up to {-np.min(offset):.3g}{unit} at "
            f"{inside.sum()} of {inside.size} nodes of {_name(part)}: the load has to push it back; is the "
            "foundation where it should be?",
        )
    if not np.any(touching):
        yield _open(problem, part, system, state)
    elif np.all(touching) and touching.size >= FEW:
        yield SetupWarning(
            "all-touching",
            f"all {touching.size} nodes of {_name(part)} touch the foundation: the edge of the contact is "
            "not on it; a given displacement may be what is meant, or a longer contact boundary",
        )
    elif touching.sum() < FEW and problem.components == 2:
        yield SetupWarning(
            "unresolved",
            f"only {touching.sum()} of {touching.size} nodes of {_name(part)} touch the foundation: the mesh "
            "is too coarse there for pressures",
        )


def _open(
    problem: ContactProblem, part: ContactSet, system: ContactSystem, state: Equilibrium
) -> SetupWarning:
    """Contact that never closes, and the likeliest reason."""
    offset = system.offset[part.rows]
    change = (system.normals @ state.u)[part.rows]
    least, unit = float(np.min(offset + change)), after(problem.units.length)
    text = f"contact on {_name(part)} never closes: under the load its gap is {least:.3g}{unit} or more"
    nearest = float(np.min(offset))
    moved = float(np.max(np.abs(change), initial=0.0))
    if problem.components == 2 and nearest > _extent(problem):
        return SetupWarning("open", f"{text}; the foundation is farther off than the body is long")
    if moved > 0 and np.min(change) >= -1e-3 * moved:
        return SetupWarning("away", f"{text}; the load moves it away from the foundation: is its sign right?")
    if moved < FAR * nearest:
        moves = f"it moves by {moved:.2g} where the gap is {nearest:.2g}"
        return SetupWarning("open", f"{text}; {moves}: check units")
    return SetupWarning("open", text)


def _point_loads(problem: ContactProblem) -> Iterator[SetupWarning]:
    if problem.point_loads:
        yield SetupWarning(
            "point-load",
            "a point load has no finite energy in the plane: its energy falls without end as the mesh is "
            "refined, so compare energies on this mesh only",
        )


def _round(problem: ContactProblem) -> Iterator[SetupWarning]:
    """Contact boundaries that bend at every node, where nodes cannot slide without a curve."""
    for part in problem.contact_sets:
        name = part.obstacle.boundary
        if isinstance(name, Place) or name in problem.motion.curves or name in problem.motion.pinned:
            continue
        turns = _turns(problem, name)
        round_ones = np.count_nonzero((turns > STRAIGHT) & (turns < BEND))
        if round_ones >= FEW and 2 * round_ones > turns.size:
            yield SetupWarning(
                "round",
                f"{name!r} bends at {round_ones} of its {turns.size} inner nodes, which are fixed: say which "
                f"curve it is on, as in [curves] {name} = 'circle' or 'spline', and they slide along it",
            )


def _turns(problem: ContactProblem, name: str) -> Array:
    """Angles in radians by which a boundary turns at its inner nodes."""
    edges = problem.mesh.facets[:, np.asarray(problem.mesh.boundaries[name])]
    nodes, count = np.unique(edges, return_counts=True)
    turns = []
    for node in nodes[count == 2]:
        at = np.flatnonzero(np.any(edges == node, axis=0))
        one, two = (problem.mesh.p[:, edges[:, k].sum() - node] - problem.mesh.p[:, node] for k in at)
        turns.append(np.pi - np.arccos(np.clip(one @ two / np.linalg.norm(one) / np.linalg.norm(two), -1, 1)))
    return np.array(turns)


def _sizes(problem: ContactProblem, u: Array) -> Iterator[SetupWarning]:
    if problem.components == 1:
        return
    largest, extent = float(np.max(np.abs(u))), _extent(problem)
    unit = after(problem.units.length)
    said = f"the largest displacement is {largest:.2g}{unit} and the body {extent:.2g}{unit} long"
    if largest > extent:
        yield SetupWarning("large", f"{said}: check units (modulus, loads, lengths)")
    elif largest > LARGE * extent:
        yield SetupWarning("large", f"{said}: small strains and gaps at the undeformed place do not hold")
    elif 0 < largest < TINY * extent:
        yield SetupWarning("tiny", f"{said}: check units (modulus, loads, lengths)")


def _materials(problem: ContactProblem) -> Iterator[SetupWarning]:
    for law in problem.laws:
        if isinstance(law, Laplace) or not isinstance(law, PlaneStrain):
            continue
        poisson = law.lame_lambda / (2 * (law.lame_lambda + law.lame_mu))
        if poisson > LOCKING:
            yield SetupWarning(
                "locking",
                f"Poisson's ratio is {poisson:.4g} in plane strain: linear triangles lock above {LOCKING}, "
                "and displacements come out too small",
            )


def _loads(problem: ContactProblem, system: ContactSystem, accurate: Array | None) -> Iterator[SetupWarning]:
    given = bool(problem.tractions) or any(callable(c) or c != 0 for law in problem.laws for c in law.load)
    held, value = problem.held()
    if given and not np.any(value[held]) and not np.any(system.load):
        yield SetupWarning("load", "the loads vanish on this mesh: do they use the same lengths as the mesh?")
        return
    if accurate is not None and any(callable(c) for law in problem.laws for c in law.load):
        wrong = float(np.sum(np.abs(system.load - accurate)) / max(np.sum(np.abs(accurate)), 1e-300))
        if wrong > LOAD_ERROR:
            yield SetupWarning(
                "load",
                f"the nodal loads are wrong by {wrong:.0%}: the load varies on a scale that the mesh with "
                f"the rule {problem.quadrature!r} does not see; refine, or raise quadrature",
            )


def _extent(problem: ContactProblem) -> float:
    used: NDArray[np.int64] = np.unique(problem.mesh.t)
    return float(np.max(np.ptp(problem.mesh.p[:, used], axis=1)))


def _name(part: ContactSet) -> str:
    place = part.obstacle.boundary
    return "the interior" if isinstance(place, Place) else f"{place!r}"
