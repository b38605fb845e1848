"""Signs that a problem was set up wrongly although nothing in it contradicts itself.

They cost one assembly beside a contact solution, and one of the load where it varies.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rmesh_nlp.contact.penetration import Penetration, penetrations
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ContactSystem, Equilibrium
from rmesh_nlp.errors import expect
from rmesh_nlp.evaluation import Array, largest_side, magnitude
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.meshes.curves import FITTED, fitted
from rmesh_nlp.meshes.geometry import SEVEN_DIGITS, angles, edges_on
from rmesh_nlp.problem import ContactProblem, Place
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.coefficients import is_nonzero
from rmesh_nlp.problem.data import ContactSet
from rmesh_nlp.problem.laws import LOCKING
from rmesh_nlp.problem.lines import joints
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
        load, idle, point-load, round.
    message : str
        One sentence for people, with the figure that it rests on.
    """

    kind: str
    message: str


def check(problem: ContactProblem) -> list[str]:
    """Say what looks wrong about a problem, in sentences, after a contact solve on its mesh as given.

    Such as a foundation that overlaps the body, a load that the mesh does not see, or a curved boundary
    without a curve. ``rmesh check FILE`` prints them.
    """
    expect("problem", problem, ContactProblem)
    model = ContactSolver(problem.at_design())
    space, u = model.discretisation.space, model.displacement.values(model.given.u)
    passing = penetrations(space, model.problem.mesh.p, u)
    signs = (*curve_warnings(problem), *setup_warnings(model), *penetration_warnings(passing))
    return [sign.message for sign in signs]


def setup_warnings(
    model: ContactSolver,
    accurate: Array | None = None,
    nodes: Array | None = None,
    state: Equilibrium | None = None,
) -> tuple[SetupWarning, ...]:
    """All signs of a wrong set-up but penetration, from a contact solution.

    Parameters
    ----------
    model : ContactSolver
        Of the problem.
    accurate : (n_u,) array, optional
        Nodal loads by an accurate rule; without them the rule is not looked at.
    nodes : (2, vertices) array, optional
        Positions, by default as given.
    state : Equilibrium, optional
        The contact solution there, by default that on the mesh as given.
    """
    problem, space, state = model.problem, model.discretisation.space, state or model.given
    nodes = problem.mesh.p if nodes is None else nodes
    displacement, points = model.displacement.values(state.u), space.points_on_body(nodes)
    u = space.values(displacement)
    extent = largest_side(nodes[:, np.unique(problem.mesh.t)])
    scale = extent if problem.components == 2 else max(magnitude(u), 1e-300)
    return (
        *_problem(problem),
        *_loads(model, model.system(nodes), accurate),
        *_sizes(problem, u, extent),
        *(
            sign
            for part in space.contact_sets
            for sign in _contact(
                problem, part, points, state, space.values(part.relative(displacement)), scale
            )
        ),
    )


def penetration_warnings(penetrations: Sequence[Penetration]) -> Iterator[SetupWarning]:
    """Where foundations pass into the body between contact nodes."""
    for part in penetrations:
        if part.ratio > NEGLECTED:
            yield SetupWarning(
                "penetration",
                f"between its nodes {_name(part.contact)} passes into the foundation by {part.ratio:.0%} "
                f"of an edge (more than {NEGLECTED:.0%}): refine it where the foundation is curved",
            )


def _contact(
    problem: ContactProblem, part: ContactSet, points: Array, state: Equilibrium, u: Array, scale: float
) -> Iterator[SetupWarning]:
    """Of one contact set, with displacements and places of its nodes on the body, arcs where it has them."""
    obstacle, touching, points = part.obstacle, state.active.touching[part.rows], points[:, part.nodes]
    offset, change = obstacle.distances(points), np.sum(obstacle.normals(points) * u[:, part.nodes], axis=0)
    name, n, unit = _name(part), touching.size, after(problem.units.length)
    inside = offset < -1e-9 * scale
    if np.any(inside) and obstacle.force is obstacle.displacement is None and not obstacle.other:
        yield SetupWarning(
            "overlap",
            f"before any load the foundation overlaps the body by up to {-np.min(offset):.3g}{unit} at "
            f"{inside.sum()} of {n} nodes of {name}: the load has to push it back; is the "
            "foundation where it should be?",
        )
    if not np.any(touching):
        yield _open(problem, name, offset, change, scale)
    elif np.all(touching) and n >= FEW and not obstacle.other:
        yield SetupWarning(
            "all-touching",
            f"all {n} nodes of {name} touch the foundation: the edge of the contact is not on it; a given "
            "displacement may be what is meant, or a longer contact boundary",
        )
    elif touching.sum() <= (FEW - 1) * problem.order and problem.components == 2:
        yield SetupWarning(
            "unresolved",
            f"only {touching.sum()} of {n} nodes of {name} touch the foundation: the mesh is too coarse "
            "there for pressures",
        )


def _open(problem: ContactProblem, name: str, offset: Array, change: Array, extent: float) -> SetupWarning:
    """Contact that never closes, and the likeliest reason."""
    least, unit = float(np.min(offset + change)), after(problem.units.length)
    text = f"contact on {name} never closes: under the load its gap is {least:.3g}{unit} or more"
    nearest, moved = float(np.min(offset)), magnitude(change)
    if problem.components == 2 and nearest > extent:
        return SetupWarning("open", f"{text}; the foundation is farther off than the body is long")
    if moved > 0 and np.min(change) >= -1e-3 * moved:
        return SetupWarning("away", f"{text}; the load moves it away from the foundation: is its sign right?")
    text += f"; it moves by {moved:.2g} where the gap is {nearest:.2g}: check units"
    return SetupWarning("open", text)


def _problem(problem: ContactProblem) -> Iterator[SetupWarning]:
    """What needs no solution: materials that lock, point loads."""
    for poisson in problem.locking:
        yield SetupWarning(
            "locking",
            f"Poisson's ratio is {poisson:.4g}: linear triangles lock above {LOCKING}, "
            "and displacements come out too small",
        )
    if problem.point_loads:
        yield SetupWarning(
            "point-load",
            "a point load has no finite energy in the plane: its energy falls without end as the mesh is "
            "refined, so compare energies on this mesh only",
        )


def curve_warnings(problem: ContactProblem, names: Iterable[str | Place] = ()) -> Iterator[SetupWarning]:
    """Round boundaries without a curve, with the kinds of curves that the problem accepts.

    They are those of some names, or of contact.
    """
    for name in names or [obstacle.boundary for obstacle in problem.obstacles]:
        if isinstance(name, Place) or name in problem.motion.curves or name in problem.motion.pinned:
            continue
        turns = _turns(problem, name)  # of 45 degrees and more are corners
        round_ones = np.count_nonzero((turns > SEVEN_DIGITS) & (turns < np.pi / 4))
        if round_ones >= FEW and 2 * round_ones > turns.size:
            text = f"{name!r} bends at {round_ones} of its {turns.size} inner nodes, which are fixed"
            smooth = turns.max() < np.pi / 4  # a spline would round corners off
            if kinds := [repr(kind) for kind in FITTED if smooth and _is_accepted(problem, name, kind)]:
                text += f": say which curve it is on, as in [curves] {name} = {' or '.join(kinds)}, and they "
                text += "slide along it"
            else:
                text += ", and no circle or spline can be its curve here: only a finer mesh is rounder"
            yield SetupWarning("round", text)


def _is_accepted(problem: ContactProblem, name: str, kind: str) -> bool:
    """Whether a curve that is fitted to the boundary makes a problem on a valid mesh."""
    try:
        curves = {**problem.motion.curves, name: fitted(problem.mesh, name, kind)}
        curved = replace(problem, motion=replace(problem.motion, curves=curves))
        MeshMap.of(curved)
    except ValueError:
        return False
    return Body(curved, curved.mesh.p).is_upright()


def _turns(problem: ContactProblem, name: str) -> Array:
    """Angles in radians by which a boundary turns at its inner nodes."""
    edges = edges_on(problem.mesh, name)
    node, *both = joints(edges)
    corners = np.stack([node, *(edges[:, which].sum(axis=0) - node for which in both)])
    return np.pi - angles(problem.mesh.p, corners)[0]


def _sizes(problem: ContactProblem, u: Array, extent: float) -> Iterator[SetupWarning]:
    if problem.components == 1:
        return
    largest = magnitude(u)
    unit = after(problem.units.length)
    said = f"the largest displacement is {largest:.2g}{unit} and the body {extent:.2g}{unit} long"
    if largest > extent:
        yield SetupWarning("large", f"{said}: check units (modulus, loads, lengths)")
    elif largest > NEGLECTED * extent:
        yield SetupWarning("large", f"{said}: small strains and gaps at the undeformed place do not hold")
    elif 0 < largest < TINY * extent:
        yield SetupWarning("tiny", f"{said}: check units (modulus, loads, lengths)")


def _loads(model: ContactSolver, system: ContactSystem, accurate: Array | None) -> Iterator[SetupWarning]:
    problem, index = model.problem, model.displacement.index
    loads = [part for law in problem.laws for part in law.load]
    varying = any(map(callable, loads))
    for traction in problem.tractions:
        nodes = model.discretisation.space.nodes_of(edges_on(problem.mesh, traction.boundary))
        is_axis = np.all(problem.on_axis[problem.boundary_nodes(traction.boundary)])
        for i, part in enumerate(traction.value):
            if np.any(index[i, nodes] >= 0) and not is_axis:
                loads += [part]
            elif is_nonzero(part):
                yield SetupWarning(
                    "idle",
                    f"component {i + 1} of the traction on {traction.boundary!r} has no effect: "
                    f"{'r is 0 there' if is_axis else 'the displacement is given there in this component'}",
                )
    if any(map(is_nonzero, loads)) and not np.any(system.load):  # which has what given displacements pull
        yield SetupWarning("load", "the loads vanish on this mesh: do they use the same lengths as the mesh?")
    elif accurate is not None and varying:
        wrong = float(np.sum(np.abs(system.load - accurate)) / max(np.sum(np.abs(accurate)), 1e-300))
        if wrong > NEGLECTED:
            yield SetupWarning(
                "load",
                f"the nodal loads are wrong by {wrong:.0%}: the load varies on a scale that the mesh with "
                f"the rule {problem.quadrature!r} does not see; refine, or raise quadrature",
            )


def _name(part: ContactSet) -> str:
    place = part.obstacle.boundary
    return "the interior" if isinstance(place, Place) else f"{place!r}"
