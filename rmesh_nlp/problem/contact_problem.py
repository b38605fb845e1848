"""A contact problem as its user describes it: frozen, and checked when it is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from skfem import MeshTri

from rmesh_nlp.display import Rows, Shown, bounds_in_words, describe, figure
from rmesh_nlp.errors import ProblemError, expect
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.arrays import named
from rmesh_nlp.meshes.geometry import counter_clockwise, edge_keys, lengths, named_by_user
from rmesh_nlp.problem.checks import check, check_names, check_pairs
from rmesh_nlp.problem.coefficients import as_tuple
from rmesh_nlp.problem.conditions import Dirichlet, LoadStep, PointLoad, Traction, changed
from rmesh_nlp.problem.data import ProblemData
from rmesh_nlp.problem.design import Constraint, DesignVariable, Shape, at_design, names_in
from rmesh_nlp.problem.laws import Law
from rmesh_nlp.problem.lines import harmonic_motions, onto_curves, onto_lines
from rmesh_nlp.problem.motion import RULES, Motion, Relative
from rmesh_nlp.problem.obstacle import Obstacle
from rmesh_nlp.problem.pairs import edges_of_pair, paired
from rmesh_nlp.problem.units import Units, after

KINDS: dict[str, tuple[tuple[type, ...], str]] = {
    "laws": ((Law,), "Laplace, PlaneStrain, PlaneStress or Axisymmetric"),
    "dirichlet": ((str, Dirichlet), "names of boundaries or Dirichlet"),
    "tractions": ((Traction,), "Traction"),
    "point_loads": ((PointLoad,), "PointLoad"),
    "obstacle": ((Obstacle,), "Obstacle"),
    "motion": ((Motion,), "Motion"),
    "design": ((DesignVariable, Shape), "DesignVariable or Shape"),
    "constraints": ((Constraint,), "Constraint"),
    "steps": ((LoadStep,), "LoadStep"),
    "units": ((Units,), "Units"),
}
"""What some fields of a problem consist of."""


@dataclass(frozen=True, repr=False)
class ContactProblem(Shown, ProblemData):
    """A contact problem on a mesh with movable nodes, checked when it is made.

    All numbers are in one consistent system of units; energies and forces are per unit thickness, or of the
    whole of a body of revolution.

    Parameters
    ----------
    mesh : skfem.MeshTri
        First-order triangles with named boundaries, and named subdomains for several laws.
    law : Laplace, PlaneStrain, PlaneStress, Axisymmetric, or a mapping from subdomain names to laws
        The material. A mapping must cover every triangle exactly once.
    dirichlet : tuple of str or Dirichlet, or one alone
        Where the displacement is given, in units of length; a plain name fixes all components at zero.
    obstacle : Obstacle or tuple of Obstacle
        The rigid foundations; by default ``NO_CONTACT``.
    motion : Motion
        How far each node may move; by default as far as the elements stay valid.
    tractions : tuple of Traction, or one alone
        Loads per area of named boundaries; none by default.
    quadrature : "auto", "midpoint" or int
        Rule for the source or body force: the three edge midpoints (degree 2), or a degree. By default
        "auto", one that is exact for a polynomial load and of degree 8 for any other, see ``rule``.
    exact : ExactSolution, optional
        A known solution, for errors and the terms of Theorem 4.1.
    name, size : str
        Names of the problem and of its mesh in records and files; "problem" and "" by default.
    point_loads : tuple of PointLoad, or one alone
        Forces at single nodes; none by default.
    order : 1 or 2
        Of the displacements on each triangle: linear, or quadratic with unknowns at edges too.
    design : tuple of DesignVariable or Shape, or one alone
        Numbers besides the positions of nodes that are optimised; none by default.
    constraints : tuple of Constraint, or one alone
        What the optimised mesh and design must keep; none by default.
    units : Units
        Names of the units, written in texts and figures only; none by default.
    steps : tuple of LoadStep, or one alone
        Loads that follow those of the problem one after the other, on the mesh as given; none by default.
    origin : (components, nodes and tools) array, optional
        The displacement that friction counts slip from, that of the load step before; zero by default.
    numbers : mapping of str to float
        What :meth:`at_design` has put in the place of design variables.
    reference : (2, 3, elements) array, optional
        Vertices of the triangles that distortions compare the elements with, in units of length; by default
        those of the mesh.

    Raises
    ------
    ProblemError
        If a name is unknown, numbers of components disagree, given displacements contradict each
        other or leave a rigid motion, or a value is not finite.
    """

    def __post_init__(self) -> None:
        for name, (kinds, what) in KINDS.items():
            given = getattr(self, name)
            needed = name in ("laws", "obstacle", "motion", "units")
            every = () if given is None and not needed else as_tuple(given)
            wrong = [value for value in every if not isinstance(value, kinds)]
            if wrong or isinstance(given, Mapping):
                raise ProblemError(name, f"{name} must be {what}, got {wrong[0] if wrong else given!r}")
            if not needed:
                object.__setattr__(self, name, every)
        check_pairs(self)
        mesh, obstacles, curves = paired(self.mesh, self.obstacles, self.motion.curves)
        if mesh is not self.mesh or obstacles != self.obstacles:
            object.__setattr__(self, "mesh", mesh)
            object.__setattr__(self, "obstacle", obstacles)
            object.__setattr__(self, "motion", replace(self.motion, curves=curves))
        if self.design:
            self._check_design()
        else:
            check(self)
        each = self
        for number, step in enumerate(self.steps):
            try:
                each = each.after(step, None)
            except ProblemError as error:
                raise ProblemError(("steps", number, *error.place), str(error)) from error
        per = "revolution" if self.axisymmetric else ""
        object.__setattr__(self, "units", replace(self.units, per=per))
        object.__setattr__(self, "mesh", onto_curves(onto_lines(self.mesh), self.motion.curves))

    def _check_design(self) -> None:
        """Whether the names are known, and the problem makes sense at the first design."""
        names = [variable.name for variable in self.design]
        for name in names:
            if names.count(name) > 1:
                raise ProblemError("design", f"two design variables are named {name!r}")
        parts = (*self.laws, *self.tractions, *self.point_loads, *self.obstacles, *self.supports)
        for name in sorted({name for part in parts for name in names_in(part)} - set(names)):
            raise ProblemError("design", f"{name!r} is no design variable: choose from {', '.join(names)}")
        for support in self.supports:
            if used := names_in(support):
                raise ProblemError(
                    ("dirichlet", support.boundary),
                    f"the displacement given on {support.boundary!r} cannot depend on {used[0]!r}",
                )
        for obstacle in self.obstacles:
            on_arcs = obstacle.boundary in self.motion.curves and not obstacle.other
            if on_arcs and (used := names_in(obstacle)):
                raise ProblemError(
                    "design",
                    f"gaps hold along the arcs of {obstacle.boundary!r}, where no foundation can depend "
                    f"on a design variable yet, as {used[0]!r} does",
                )
        check_names(self)
        self.at_design()

    @cached_property
    def shape_motions(self) -> Array:
        """(shapes, 2, nodes) displacements of all nodes at amplitude 1 of each shape."""
        return harmonic_motions(self)

    def at_design(self, values: Mapping[str, float] | None = None) -> ContactProblem:
        """The problem with numbers in the place of its design variables, by default those of its start.

        The mesh is moved by its shapes; constraints are left out, and distortions compare with the same
        triangles as before.
        """
        if not self.design:
            return self
        at = {**self.start, **(values or {})}
        amplitudes = np.array([at[shape.name] for shape in self.shapes])
        moved = self.mesh.p + np.tensordot(amplitudes, self.shape_motions, 1)
        laws = {name: at_design(law, at) for name, law in self.laws_by_name.items()}
        return replace(
            self,
            mesh=replace(self.mesh, doflocs=moved) if np.any(amplitudes) else self.mesh,
            law=laws if isinstance(self.law, Mapping) else laws[""],
            tractions=at_design(self.tractions, at),
            point_loads=at_design(self.point_loads, at),
            obstacle=at_design(as_tuple(self.obstacle), at),
            steps=at_design(self.steps, at),
            reference=self.mesh.p[:, self.triangles] if self.reference is None else self.reference,
            design=(),
            constraints=(),
            numbers=at,
        )

    def after(self, step: LoadStep, origin: Array | None) -> ContactProblem:
        """The problem of the next load step, whose slip is counted from a displacement ``origin``."""
        known = {str(part.boundary) for part in self.obstacles if part.force is not None}
        for name in step.tools:
            if name not in known:
                raise ProblemError("tools", f"no tool under a force meets {name!r}")
        return replace(
            self,
            tractions=changed(self.tractions, step.tractions, "boundary"),
            point_loads=changed(self.point_loads, step.point_loads, "node"),
            dirichlet=changed(self.supports, step.dirichlet, "boundary"),
            obstacle=tuple(
                replace(part, force=step.tools.get(str(part.boundary), part.force)) for part in self.obstacles
            ),
            steps=(),
            origin=origin,
        )

    def with_rule(self, rule: str | int) -> ContactProblem:
        """The same problem with another quadrature rule; no check depends on it, so none is repeated."""
        other = copy(self)
        vars(other).update(quadrature=rule)
        vars(other).pop("rule", None)
        return other

    def placed(self, tools: Mapping[int, Sequence[float]]) -> ContactProblem:
        """The problem with tools, by their numbers, held where they are moved to; nothing is checked."""
        other, obstacles = copy(self), list(self.obstacles)
        for number, moved in tools.items():
            obstacles[number] = replace(obstacles[number], force=None, move=None, displacement=tuple(moved))
        vars(other).update(obstacle=tuple(obstacles))
        for name in ("tools", "partners", "contact_sets", "first_obstacles"):
            vars(other).pop(name, None)
        return other

    def summary(self) -> Rows:
        """Mesh, laws, loads, contact and motion, as (label, value) rows for people."""
        mesh = self.mesh
        (x0, y0), (x1, y1) = mesh.p.min(axis=1), mesh.p.max(axis=1)
        size = lengths(mesh.p, mesh.facets)
        edges = [
            f"{n} ({e.size}, {figure(size[e].sum())})" for n, e in named_by_user(mesh.boundaries).items()
        ]
        parts = [f"{name} ({part.size})" for name, part in named_by_user(mesh.subdomains).items()]
        rows = [
            ("mesh", f"{mesh.p.shape[1]} nodes, {mesh.nelements} triangles"),
            ("extent", f"({figure(x0)}, {figure(x1)}) x ({figure(y0)}, {figure(y1)})"),
            ("boundaries (edges, length)", ", ".join(edges)),
            ("subdomains (triangles)", ", ".join(parts)),
        ]
        stress = after(self.units.stress)
        if self.order == 2:
            rows.append(("displacements", "quadratic on each triangle"))
        for variable in self.design:
            low, high = variable.bounds
            what = f"from {figure(variable.start)}, {figure(low)} to {figure(high)}"
            rows.append((f"design variable {variable.name}", what))
        rows += [(f"constraint {c.value}", bounds_in_words(*c.bounds)) for c in self.constraints]
        rows += [(f"law of {e.size} triangles", law.in_words(stress)) for law, e in self.regions]
        given = [(f"given on {c.boundary}", c.value) for c in self.supports]
        given += [(f"traction on {c.boundary}", c.value) for c in self.tractions]
        given += [(f"force at node {c.node}", c.force) for c in self.point_loads]
        rows += [(label, ", ".join(map(describe, value))) for label, value in given]
        rows += [("load steps", f"{len(self.steps) + 1}")] * bool(self.steps)
        for part in self.contact_sets:
            nodes = "pairs of nodes, 0 apart," if part.obstacle.other else "nodes"
            rows.append(("contact", f"{part.nodes.size} {nodes} {part.obstacle.in_words()}"))
        rows += [("contact", "none")] * (not self.contact_sets)
        return [*rows, ("motion", self.motion.in_words())]

    @property
    def title(self) -> str:
        """What it is, for people."""
        return f"Contact problem {self.name!r}"


def refined(problem: ContactProblem, *, mesh: MeshTri | None = None) -> ContactProblem:
    """The same problem with every triangle cut into four, names kept; move limits keep their widths.

    Relative ones do so up to the new shortest edge.
    ``mesh`` takes the place of that of the problem. New nodes of a boundary with a curve are on the curve.
    """
    expect("problem", problem, ContactProblem)
    motion = problem.motion
    if isinstance(motion.delta, Relative):
        motion = replace(motion, delta=Relative(min(1.0, 2 * motion.delta.fraction)))
    return on_mesh(problem, (problem.mesh if mesh is None else mesh).refined(1), motion)


def locally_refined(problem: ContactProblem, elements: NDArray) -> ContactProblem:
    """The problem with some triangles refined as by :func:`bisected`."""
    return on_mesh(problem, bisected(problem, problem.mesh, elements), problem.motion)


def bisected(problem: ContactProblem, old: MeshTri, elements: NDArray) -> MeshTri:
    """A mesh of a problem with some triangles refined, and what neighbours need.

    Old nodes keep their numbers. The edges of a pair are halved on both sides or on none.
    """
    (a, b), chosen = old.facets, np.unique(elements)
    sides = [edges_of_pair(old, *names) for names in problem.pairs]
    while True:
        new = replace(old, _boundaries=None).refined(chosen)
        n, keys = new.p.shape[1], edge_keys(new.facets, new.p.shape[1])
        whole = np.isin(edge_keys(old.facets, n), keys)
        uneven = np.hstack([np.zeros(0, int), *(both[whole[both] & ~whole[both[::-1]]] for both in sides)])
        if uneven.size == 0:
            break
        chosen = np.union1d(chosen, old.f2t[0, uneven])
    near = cKDTree(new.p.T).query((old.p[:, a] + old.p[:, b]).T / 2, k=2)[1].T  # of a pair both are there
    # at the end of a crack the edges of both sides begin at one node
    is_first = np.logical_and(*(np.isin(edge_keys(np.stack([end, near[0]]), n), keys) for end in (a, b)))
    middle = np.where(is_first, *near)
    pieces = np.where(whole, [a, b, a, b], [a, middle, middle, b])
    boundaries = {name: pieces[:, facets].T.reshape(-1, 2) for name, facets in (old.boundaries or {}).items()}
    mesh = named(MeshTri(new.p, counter_clockwise(new.p, new.t)), boundaries, new.subdomains)
    return onto_curves(mesh, problem.motion.curves, anywhere=True)


def renumbered(problem: ContactProblem, mesh: MeshTri, number: Mapping[int, int]) -> ContactProblem:
    """The problem on another mesh of its domain, ``number`` the new numbers of nodes that it names."""
    motion = problem.motion
    places: dict[str, Any] = {
        rule: tuple(place if isinstance(place, str) else number[place] for place in getattr(motion, rule))
        for rule in RULES
    }
    tied = tuple((number[a], number[b]) for a, b in motion.tied)
    loads = tuple(replace(load, node=number[load.node]) for load in problem.point_loads)
    return on_mesh(problem, mesh, replace(motion, tied=tied, **places), point_loads=loads)


def on_mesh(problem: ContactProblem, mesh: MeshTri, motion: Motion, **changes: Any) -> ContactProblem:
    """The problem on another mesh of its domain, whose nodes are put on their curves."""
    mesh = onto_curves(mesh, motion.curves, anywhere=True)
    return replace(
        problem, mesh=mesh, motion=motion, size=f"{mesh.nelements} triangles", reference=None, **changes
    )
