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
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.data import ContactSet
from rmesh_nlp.problem.laws import LOCKING
from rmesh_nlp.problem.units import after

PENETRATION = 0.05
"""Part of the length of a contact edge that a foundation may pass into it between its nodes."""

NEGLECTED = 0.1
"""Part from which on what is neglected is not small: of displacements in the extent of the body, and of the
difference of nodal loads by the problem's rule and by one of high degree in these loads."""

TINY = 1e-7
"""The same below which units do not fit: steel under a hundredth of its yield stress moves by 1e-5."""

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
    space, coefficients = model.discretisation.space, model.displacement.values(state.u)
    u = space.values(coefficients)
    signs = [*_problem(problem), *_loads(problem, system, accurate), *_sizes(problem, u)]
    for part in space.contact_sets:
        signs += _contact(space, part, system, state, u)
    warnings = tuple(SetupWarning(kind, message) for kind, message in signs)
    return (*warnings, *penetration_warnings(space, problem.mesh.p, coefficients))


def penetration_warnings(space: DisplacementSpace, nodes: Array, displacement: Array) -> list[SetupWarning]:
    """Where foundations pass into the body between contact nodes, at any vertex positions (2, vertices)."""
    warnings, problem = [], space.problem
    for part in problem.contact_sets:
        if problem.components == 1 or part.obstacle.boundary is Place.INTERIOR:
            continue  # a displacement of its own unit: there is no edge to compare with
        depth, length = penetrations(Body(problem, nodes), space, part.obstacle, displacement)
        ratio = float(np.max(depth / length, initial=0.0))
        if ratio > PENETRATION:
            message = (
                f"between its nodes {_name(part)} passes into the foundation by {ratio:.0%} "
                f"of an edge (more than {PENETRATION:.0%}): refine it where the foundation is curved"
            )
            warnings.append(SetupWarning("penetration", message))
    return warnings


Found = Iterator[tuple[str, str]]
"""Kinds and messages."""


def _contact(
    space: DisplacementSpace, part: ContactSet, system: ContactSystem, state: Equilibrium, u: Array
) -> Found:
    problem = space.problem
    offset, touching = system.offset[part.rows], state.active.touching[part.rows]
    # nodes keep off the foundation, or at edges are coefficients: neither is an overlap
    if holds_along_edges(problem, part.obstacle) or space.order == 2:
        offset = part.obstacle.distances(space.points(problem.mesh.p)[:, part.nodes])
    name, n, unit = _name(part), touching.size, after(problem.units.length)
    scale = _extent(problem) if problem.components == 2 else max(float(np.max(np.abs(u))), 1e-300)
    inside = offset < -1e-9 * scale
    if np.any(inside):
        text = f"before any load the foundation overlaps the body by up to {-np.min(offset):.3g}{unit} at "
        text += f"{inside.sum()} of {n} nodes of {name}: the load has to push it back; is the "
        yield "overlap", text + "foundation where it should be?"
    if not np.any(touching):
        yield _open(problem, part, system, state)
    elif np.all(touching) and n >= FEW:
        text = f"all {n} nodes of {name} touch the foundation: the edge of the contact is not on it; a given "
        yield "all-touching", text + "displacement may be what is meant, or a longer contact boundary"
    elif touching.sum() < FEW and problem.components == 2:
        text = f"only {touching.sum()} of {n} nodes of {name} touch the foundation: the mesh is too coarse "
        yield "unresolved", text + "there for pressures"


def _open(
    problem: ContactProblem, part: ContactSet, system: ContactSystem, state: Equilibrium
) -> tuple[str, str]:
    """Contact that never closes, and the likeliest reason."""
    offset, change = system.offset[part.rows], (system.normals @ state.u)[part.rows]
    least, unit = float(np.min(offset + change)), after(problem.units.length)
    text = f"contact on {_name(part)} never closes: under the load its gap is {least:.3g}{unit} or more"
    nearest, moved = float(np.min(offset)), float(np.max(np.abs(change), initial=0.0))
    if problem.components == 2 and nearest > _extent(problem):
        return "open", f"{text}; the foundation is farther off than the body is long"
    if moved > 0 and np.min(change) >= -1e-3 * moved:
        return "away", f"{text}; the load moves it away from the foundation: is its sign right?"
    return "open", f"{text}; it moves by {moved:.2g} where the gap is {nearest:.2g}: check units"


def _problem(problem: ContactProblem) -> Found:
    """What needs no solution: materials that lock, point loads, round boundaries without a curve."""
    for poisson in problem.locking:
        text = f"Poisson's ratio is {poisson:.4g} in plane strain: linear triangles lock above {LOCKING}, "
        yield "locking", text + "and displacements come out too small"
    if problem.point_loads:
        text = "a point load has no finite energy in the plane: its energy falls without end as the mesh is "
        yield "point-load", text + "refined, so compare energies on this mesh only"
    for part in problem.contact_sets:
        name = part.obstacle.boundary
        if isinstance(name, Place) or name in problem.motion.curves or name in problem.motion.pinned:
            continue
        turns = _turns(problem, name)
        round_ones = np.count_nonzero((turns > STRAIGHT) & (turns < BEND))
        if round_ones >= FEW and 2 * round_ones > turns.size:
            text = f"{name!r} bends at {round_ones} of its {turns.size} inner nodes, which are fixed: say "
            text += f"which curve it is on, as in [curves] {name} = 'circle' or 'spline', and they slide "
            yield "round", text + "along it"


def _turns(problem: ContactProblem, name: str) -> Array:
    """Angles in radians by which a boundary turns at its inner nodes."""
    edges = problem.mesh.facets[:, np.asarray(problem.mesh.boundaries[name])]
    nodes, count = np.unique(edges, return_counts=True)
    turns = []
    for node in nodes[count == 2]:
        at = np.flatnonzero(np.any(edges == node, axis=0))
        a, b = (problem.mesh.p[:, edges[:, k].sum() - node] - problem.mesh.p[:, node] for k in at)
        turns.append(np.pi - np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)))
    return np.array(turns)


def _sizes(problem: ContactProblem, u: Array) -> Found:
    if problem.components == 1:
        return
    largest, extent = float(np.max(np.abs(u))), _extent(problem)
    unit = after(problem.units.length)
    said = f"the largest displacement is {largest:.2g}{unit} and the body {extent:.2g}{unit} long"
    if largest > extent:
        yield "large", f"{said}: check units (modulus, loads, lengths)"
    elif largest > NEGLECTED * extent:
        yield "large", f"{said}: small strains and gaps at the undeformed place do not hold"
    elif 0 < largest < TINY * extent:
        yield "tiny", f"{said}: check units (modulus, loads, lengths)"


def _loads(problem: ContactProblem, system: ContactSystem, accurate: Array | None) -> Found:
    varying = any(callable(c) for law in problem.laws for c in law.load)
    given = bool(problem.tractions) or any(callable(c) or c != 0 for law in problem.laws for c in law.load)
    held, value = problem.held
    if given and not np.any(value[held]) and not np.any(system.load):
        yield "load", "the loads vanish on this mesh: do they use the same lengths as the mesh?"
    elif accurate is not None and varying:
        wrong = float(np.sum(np.abs(system.load - accurate)) / max(np.sum(np.abs(accurate)), 1e-300))
        if wrong > NEGLECTED:
            text = f"the nodal loads are wrong by {wrong:.0%}: the load varies on a scale that the mesh with "
            text += f"the rule {problem.quadrature!r} does not see; refine, or raise quadrature"
            yield "load", text


def _extent(problem: ContactProblem) -> float:
    used: NDArray[np.int64] = np.unique(problem.mesh.t)
    return float(np.max(np.ptp(problem.mesh.p[:, used], axis=1)))


def _name(part: ContactSet) -> str:
    place = part.obstacle.boundary
    return "the interior" if isinstance(place, Place) else f"{place!r}"
