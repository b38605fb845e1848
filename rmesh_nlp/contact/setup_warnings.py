"""Signs that a problem was set up wrongly although nothing in it contradicts itself.

What is looked at costs one contact solve on the given mesh, and one assembly of the load where it varies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from rmesh_nlp.contact.penetration import Penetration
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array, largest_side, magnitude
from rmesh_nlp.fem.edge_gaps import holds_along_edges
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.geometry import SEVEN_DIGITS
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.data import ContactSet
from rmesh_nlp.problem.laws import LOCKING
from rmesh_nlp.problem.units import after

NEGLECTED = 0.1
"""Part from which on what is neglected is not small: of displacements in the extent of the body, of the
difference of nodal loads by the problem's rule and by one of high degree in these loads, and of the depth of
a foundation in a contact edge between its nodes in the length of the edge."""

TINY = 1e-7
"""The same below which units do not fit: steel under a hundredth of its yield stress moves by 1e-5."""

FEW = 3
"""Touching nodes below which a contact is not resolved, and nodes at which a boundary bends that is round."""


class SetupWarning(NamedTuple):
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


def setup_warnings(model: ContactSolver, accurate: Array | None = None) -> tuple[SetupWarning, ...]:
    """All signs of a wrong set-up but penetration, from the contact solution on the given mesh.

    Parameters
    ----------
    model : ContactSolver
        Of the problem.
    accurate : (n_u,) array, optional
        Nodal loads by an accurate rule; without them the rule is not looked at.
    """
    problem, space = model.problem, model.discretisation.space
    system, u = model.system(problem.mesh.p), space.values(model.displacement.values(model.given.u))
    return (
        *_problem(problem),
        *_loads(problem, system, accurate),
        *_sizes(problem, u),
        *(sign for part in space.contact_sets for sign in _contact(space, part, system, model.given, u)),
    )


def penetration_warnings(penetrations: Sequence[Penetration]) -> Iterator[SetupWarning]:
    """Where foundations pass into the body between contact nodes."""
    for part in penetrations:
        if part.ratio > NEGLECTED:
            text = f"between its nodes {_name(part.contact)} passes into the foundation by {part.ratio:.0%} "
            text += f"of an edge (more than {NEGLECTED:.0%}): refine it where the foundation is curved"
            yield SetupWarning("penetration", text)


def _contact(
    space: DisplacementSpace, part: ContactSet, system: ContactSystem, state: Equilibrium, u: Array
) -> Iterator[SetupWarning]:
    problem = space.problem
    offset, touching = system.offset[part.rows], state.active.touching[part.rows]
    # nodes keep off the foundation, or at edges are coefficients: neither is an overlap
    if holds_along_edges(problem, part.obstacle) or space.order == 2:
        offset = part.obstacle.distances(space.points(problem.mesh.p)[:, part.nodes])
    name, n, unit = _name(part), touching.size, after(problem.units.length)
    scale = _extent(problem) if problem.components == 2 else max(magnitude(u), 1e-300)
    inside = offset < -1e-9 * scale
    if np.any(inside):
        text = f"before any load the foundation overlaps the body by up to {-np.min(offset):.3g}{unit} at "
        text += f"{inside.sum()} of {n} nodes of {name}: the load has to push it back; is the "
        yield SetupWarning("overlap", text + "foundation where it should be?")
    if not np.any(touching):
        yield _open(problem, part, system, state)
    elif np.all(touching) and n >= FEW:
        text = f"all {n} nodes of {name} touch the foundation: the edge of the contact is not on it; a given "
        text += "displacement may be what is meant, or a longer contact boundary"
        yield SetupWarning("all-touching", text)
    elif touching.sum() <= (FEW - 1) * space.order and problem.components == 2:
        text = f"only {touching.sum()} of {n} nodes of {name} touch the foundation: the mesh is too coarse "
        yield SetupWarning("unresolved", text + "there for pressures")


def _open(
    problem: ContactProblem, part: ContactSet, system: ContactSystem, state: Equilibrium
) -> SetupWarning:
    """Contact that never closes, and the likeliest reason."""
    offset, change = system.offset[part.rows], (system.normals @ state.u)[part.rows]
    least, unit = float(np.min(offset + change)), after(problem.units.length)
    text = f"contact on {_name(part)} never closes: under the load its gap is {least:.3g}{unit} or more"
    nearest, moved = float(np.min(offset)), magnitude(change)
    if problem.components == 2 and nearest > _extent(problem):
        return SetupWarning("open", f"{text}; the foundation is farther off than the body is long")
    if moved > 0 and np.min(change) >= -1e-3 * moved:
        text += "; the load moves it away from the foundation: is its sign right?"
        return SetupWarning("away", text)
    text += f"; it moves by {moved:.2g} where the gap is {nearest:.2g}: check units"
    return SetupWarning("open", text)


def _problem(problem: ContactProblem) -> Iterator[SetupWarning]:
    """What needs no solution: materials that lock, point loads, round boundaries without a curve."""
    for poisson in problem.locking:
        text = f"Poisson's ratio is {poisson:.4g} in plane strain: linear triangles lock above {LOCKING}, "
        yield SetupWarning("locking", text + "and displacements come out too small")
    if problem.point_loads:
        text = "a point load has no finite energy in the plane: its energy falls without end as the mesh is "
        yield SetupWarning("point-load", text + "refined, so compare energies on this mesh only")
    for part in problem.contact_sets:
        name = part.obstacle.boundary
        if isinstance(name, Place) or name in problem.motion.curves or name in problem.motion.pinned:
            continue
        turns = _turns(problem, name)  # of 45 degrees and more are corners
        round_ones = np.count_nonzero((turns > SEVEN_DIGITS) & (turns < np.pi / 4))
        if round_ones >= FEW and 2 * round_ones > turns.size:
            text = f"{name!r} bends at {round_ones} of its {turns.size} inner nodes, which are fixed: say "
            text += f"which curve it is on, as in [curves] {name} = 'circle' or 'spline', and they slide "
            yield SetupWarning("round", text + "along it")


def _turns(problem: ContactProblem, name: str) -> Array:
    """Angles in radians by which a boundary turns at its inner nodes."""
    edges = problem.mesh.facets[:, problem.mesh.boundaries[name]]
    along = problem.mesh.p[:, edges[1]] - problem.mesh.p[:, edges[0]]
    outward = np.hstack([along, -along]) / np.tile(np.linalg.norm(along, axis=0), 2)  # from each end
    order = np.argsort(edges.ravel())
    _, first, count = np.unique(edges.ravel()[order], return_index=True, return_counts=True)
    a, b = (outward[:, order[first[count == 2] + side]] for side in range(2))
    return np.pi - np.arccos(np.clip(np.sum(a * b, axis=0), -1, 1))


def _sizes(problem: ContactProblem, u: Array) -> Iterator[SetupWarning]:
    if problem.components == 1:
        return
    largest, extent = magnitude(u), _extent(problem)
    unit = after(problem.units.length)
    said = f"the largest displacement is {largest:.2g}{unit} and the body {extent:.2g}{unit} long"
    if largest > extent:
        yield SetupWarning("large", f"{said}: check units (modulus, loads, lengths)")
    elif largest > NEGLECTED * extent:
        yield SetupWarning("large", f"{said}: small strains and gaps at the undeformed place do not hold")
    elif 0 < largest < TINY * extent:
        yield SetupWarning("tiny", f"{said}: check units (modulus, loads, lengths)")


def _loads(problem: ContactProblem, system: ContactSystem, accurate: Array | None) -> Iterator[SetupWarning]:
    varying = any(callable(c) for law in problem.laws for c in law.load)
    given = bool(problem.tractions) or any(callable(c) or c != 0 for law in problem.laws for c in law.load)
    if given and not np.any(system.load):  # which has what given displacements pull
        text = "the loads vanish on this mesh: do they use the same lengths as the mesh?"
        yield SetupWarning("load", text)
    elif accurate is not None and varying:
        wrong = float(np.sum(np.abs(system.load - accurate)) / max(np.sum(np.abs(accurate)), 1e-300))
        if wrong > NEGLECTED:
            text = f"the nodal loads are wrong by {wrong:.0%}: the load varies on a scale that the mesh with "
            text += f"the rule {problem.quadrature!r} does not see; refine, or raise quadrature"
            yield SetupWarning("load", text)


def _extent(problem: ContactProblem) -> float:
    return largest_side(problem.mesh.p[:, np.unique(problem.mesh.t)])


def _name(part: ContactSet) -> str:
    place = part.obstacle.boundary
    return "the interior" if isinstance(place, Place) else f"{place!r}"
