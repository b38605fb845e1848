"""Estimated errors of contact forces and other quantities, with corrected values and where the errors arise.

Where a field in equilibrium is known (:mod:`rmesh_nlp.certificate.equilibration`), a contact force is

    R  ~  int p^ (n . w_h),

p^ the equilibrated pressure, w_h the displacement of the same mesh that is 1 on the nodes that touch, without
load: the computed force and the integral of (sigma^ - C eps(u_h)) : (eps(w_h) - C^-1 tau^), tau^ the
equilibrated stress of w_h [1]_. A linear quantity of the displacement is that of the equilibrated traces.
Contact ends within an edge, where w_h falls to 0; ``int p^``, as if it fell beyond, is the other choice, and
the value lies at ``BETWEEN`` of the way to it. Where nodes touch in equilibrium that do not in the computed
solution, their gaps, times the contact pressure of the dual solution, say what the change of contact is
worth. The larger of that and of the way is twice the doubt of the value, whose square adds to that of the
correction.

With Coulomb friction F the dual displacement w_h has ``w_n + F s w_t = 1`` where a node slides, s the sign of
its slip. What friction in equilibrium differs by from bounds that are given adds its work on w_h: along an
edge where a bound jumps it is the least one.

Where no such field is known (curved foundations, curved bodies, point loads), the problem is solved by richer
displacements as well: of order 2, or on the mesh refined once.

References
----------
.. [1] R. Becker, R. Rannacher, An optimal control approach to a posteriori error estimation in finite element
   methods, Acta Numerica 10 (2001) 1-102.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from rmesh_nlp.assessment.contact_results import contact_results
from rmesh_nlp.assessment.energy import shape_integrals
from rmesh_nlp.certificate import NotCertifiableError
from rmesh_nlp.certificate.equilibration import Guess, corrected
from rmesh_nlp.certificate.fields import of_displacement
from rmesh_nlp.certificate.hybrid import turned
from rmesh_nlp.certificate.integrals import tractions
from rmesh_nlp.certificate.skeleton import Skeleton, skeleton_of
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.errors import located
from rmesh_nlp.evaluation import Array
from rmesh_nlp.expressions import Expression
from rmesh_nlp.fem.contact_pressure import contact_stresses, recovered
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.fem.objective_text import load_of
from rmesh_nlp.fem.pressure import contact_on
from rmesh_nlp.fem.space import DisplacementSpace, contact_edges
from rmesh_nlp.fem.stress import strain_energies
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.coefficients import Coefficient
from rmesh_nlp.problem.contact_problem import refined
from rmesh_nlp.problem.data import ContactSet
from rmesh_nlp.problem.switches import switches
from rmesh_nlp.settings import Values

ENERGY = "energy"

RESULTS = {
    "resultant": "normal_force",
    "pressure": "",
    "peak": "peak_pressure",
    "contact_length": "contact_length",
    "force_x": "force_x",
    "force_y": "force_y",
    "moment": "moment",
}
"""Quantities that are results of a contact boundary, by the names of these."""

LEFT = 4 / 3
"""Error over the difference to the mesh refined once, if that leaves a quarter, as where it goes like h^2."""

BETWEEN = 0.8
"""Part of the way between the two choices of the dual solution at which the value is. On 260 meshes of 55
random problems, of both orders, it is off by 0.3 of their distance in the median, they by 0.8 and 0.4."""

SHARE = 0.96
"""Of a correction, how much is the error of the computed value; the rest is that of the field in equilibrium.
On those meshes it was 0.85 to 0.9, on README's block 0.97; two meshes say more."""

MORE = 1.7
"""Times as many nodes in contact on a mesh that says something of a peak beside a coarser one."""

STEADY = 0.9
"""Ratio of successive changes above which a sequence is not said to converge."""


class Estimate(NamedTuple):
    """A quantity: its best known value, the estimated error, and the computed value.

    The value is a corrected one where there is a correction, the error, of the computed value, NaN where it
    takes another mesh. ``local`` (elements,) is what each element adds to it, up to a common factor. ``half``
    is about half the width of guaranteed bounds, NaN where none are known. ``touching`` is the number of
    nodes in contact, where the values arise that have no formula. ``doubt`` is what the value of a formula
    may lack, which a mesh that is finer where contact ends would have; NaN without a formula.
    """

    value: float
    error: float
    computed: float
    local: Array
    converges: bool = True
    half: float = np.nan
    touching: int = 0
    doubt: float = np.nan

    def record(self, is_limited: bool = True) -> Values:
        """What is told of it; no error where it does not converge, or perhaps has no limit."""
        converges = is_limited and self.converges
        error = self.error if converges else np.nan
        return {"value": self.value, "error": error, "computed": self.computed, "converges": converges}


def ended(sequence: Sequence[Estimate]) -> Estimate:
    """What a sequence of ever finer meshes says of a quantity.

    The correction counts as far as the last two computed values show that it is right, by the same share on
    both meshes. Where the value changes by more than the error on the mesh before, the error is larger by
    as much. Where there is no estimate the changes are extrapolated by their ratio; values do not converge
    where the changes stay as large. The last one says something where about twice as many nodes touch as on
    the mesh before.
    """
    last, changes = sequence[-1], np.abs(np.diff([one.value for one in sequence]))
    if changes.size == 0:
        return last
    before = sequence[-2]
    if np.isfinite(last.error):
        first, second = (one.value - one.computed for one in (before, last))
        if abs(first) > 3 * before.doubt and first != second:
            share = np.clip((last.computed - before.computed) / (first - second), 2 / 3, 1.1)
            right = share * second
            last = last._replace(value=last.computed + right, error=np.hypot(right, last.doubt))
        refuted = abs(last.value - before.value) * min(last.error / max(before.error, 1e-300), 1.0)
        return last._replace(error=max(last.error, refuted))
    if MORE * before.touching > last.touching:
        return last
    ratios = np.append(STEADY, changes[1:] / np.maximum(changes[:-1], 1e-300))
    ratio, converges = np.clip(ratios[-1], 0.5, STEADY), ratios.size < 3 or np.min(ratios[-2:]) < STEADY
    return last._replace(error=np.max(changes[-2:]) * ratio / (1 - ratio), converges=bool(converges))


@dataclass(frozen=True, eq=False)
class OnMesh:
    """A contact problem solved with the vertices at ``nodes`` (2, vertices), with what estimates need."""

    problem: ContactProblem
    nodes: Array
    displacement: Field
    system: ContactSystem
    state: Equilibrium

    @classmethod
    def of(cls, solver: ContactSolver) -> OnMesh:
        """The mesh of a solver as given; a NotCertifiableError where contact is not solved."""
        nodes, state = solver.problem.mesh.p, solver.given
        if state.status is not Status.CONVERGED:
            raise NotCertifiableError(f"on {len(nodes.T)} nodes: {state.status.message}")
        return cls(solver.problem, nodes, solver.displacement, solver.given_system, state)

    @cached_property
    def space(self) -> DisplacementSpace:
        """Of the displacements."""
        return DisplacementSpace(self.problem)

    def solver(self, problem: ContactProblem) -> ContactSolver:
        """Of the problem on another mesh: it begins with the contact of the nearest nodes here."""
        own, new, active = self.space, DisplacementSpace(problem), self.state.active
        tree = cKDTree(own.points(self.nodes)[:, own.contact_nodes].T)
        near = tree.query(new.points(problem.mesh.p)[:, new.contact_nodes].T)[1]
        # where no gap was free before, nodes begin open
        touching = np.append(active.touching, False)[near]
        return ContactSolver(problem, ActiveSet(touching, np.append(active.sliding, False)[near]))

    @cached_property
    def skeleton(self) -> Skeleton:
        """Of the mesh."""
        return skeleton_of(self.problem, self.nodes)

    @cached_property
    def u(self) -> Array:
        """(components, nodes and tools) coefficients of the displacement."""
        return self.displacement.values(self.state.u)

    def ends(self, everywhere: bool = False) -> Array:
        """(2, n) places where contact ends, between nodes that touch and others; or all nodes that touch."""
        space, kind = self.space, np.zeros(self.space.n_nodes)
        kind[space.contact_nodes] = 1 + self.state.active.touching
        if everywhere:
            return space.points(self.nodes)[:, kind == 2]
        sides = [kind[space.elements] == k for k in (1, 2)]
        both = np.all(np.any(sides, axis=1), axis=0)
        points = space.points(self.nodes)[:, space.elements[:, both]]
        return np.mean([np.mean(points, axis=1, where=side[:, both]) for side in sides], axis=0)

    def dual(self, gap: Array, push: Array) -> Array:
        """The displacement under a load, both as :attr:`u`, and offsets (gaps,)."""
        index, response = self.displacement.index, self.system.response
        return np.where(index >= 0, response(self.state.active, self._free(push), gap)[index], 0.0)

    def work_of_bounds(self, w: Array) -> float:
        """Of the bounds where nodes slide, which do not depend on the pressure, on a displacement."""
        bound = self.state.active.sliding * self.system.slip_bound
        return float(bound @ self.system.tangents @ self._free(w))

    def _free(self, values: Array) -> Array:
        """(unknowns,) those of values as :attr:`u`."""
        index, free = self.displacement.index, np.zeros(self.system.load.size)
        free[index[index >= 0]] = values[index >= 0]
        return free


class Quantity(NamedTuple):
    """A quantity on one mesh.

    ``dual`` (components, nodes) is the displacement that says what residuals are worth: the solution itself
    where no other does. ``part`` and ``weights`` (nodes,) are those of an integral of pressure, of which
    ``rest`` is beyond them; the work of ``load``, on edges and on tools, is a linear quantity.
    """

    value: float
    dual: Array
    load: tuple[Array, Array] | None = None
    part: ContactSet | None = None
    weights: Array = np.zeros(0)
    rest: float = 0.0


def split(text: str) -> tuple[str, str, str]:
    """Kind, name and expression of a quantity."""
    kind, _, rest = text.strip().partition("(")
    name, _, weight = rest[:-1].partition(",")
    return kind, name.strip(), weight.strip() or "1"


def check(text: str, problem: ContactProblem) -> None:
    """Raise a BadInputError unless a text is a quantity of a problem.

    They are ``resultant(NAME)``, ``pressure(NAME, EXPR)``, the integral of the pressure times a function of x
    and y, ``force_x``, ``force_y``, ``moment``, ``peak`` and ``contact_length`` of a contact boundary,
    ``mean(NAME, EXPR)`` and ``boundary(NAME, EXPR)``, linear in the displacement, ``tool_x`` and ``tool_y``,
    the displacement of a tool that a force moves along x or y, and ``energy``.
    """
    kind, name, weight = split(text)
    if kind in RESULTS:
        with located(text):
            contact_on(DisplacementSpace(problem), name)
            Expression(weight)
    elif text not in (ENERGY, *of_tools(problem)):
        load_of(text, problem)


def pressure_integral(
    space: DisplacementSpace, nodes: Array, part: ContactSet, weight: Coefficient, force: Array
) -> tuple[float, float, Array]:
    """Integral of the pressure times a weight, what of it an interpolant would lack, and that (nodes,).

    An interpolant does not see where a weight jumps.
    """
    (on,), (weights,) = recovered(space, nodes, part, force), space.interpolant(weight, nodes)
    value = interpolated = float(on.nodal @ weights)
    if switches(weight) and len(on.cells) == 2:
        edges = Body(space.problem, nodes).edges_of(part.obstacle)
        value = float(np.sum(on.means[edges.ends] * shape_integrals(edges, weight).value))
    return value, value - interpolated, weights


def _quantity(text: str, on: OnMesh) -> Quantity:
    """A quantity by its text, see :func:`check`."""
    (kind, name, weight), space, nodes = split(text), on.space, on.nodes
    gap, push = np.zeros(space.contact_nodes.size), np.zeros(on.u.shape)
    if kind in ("resultant", "pressure"):
        part = contact_on(space, name)
        value, rest, weights = pressure_integral(
            space, nodes, part, Expression(weight), on.state.normal_force
        )
        gap[part.rows] = -weights[part.nodes]
        return Quantity(value, on.dual(gap, push), None, part, weights, rest)
    if kind in RESULTS:
        results = contact_results(space, nodes, on.system, on.state)
        return Quantity(getattr(results[name], RESULTS[kind]), on.u)
    if text == ENERGY:
        return Quantity(on.state.energy, on.u)
    tools = of_tools(on.problem)
    load = tractions(on.problem, on.skeleton, () if text in tools else (load_of(text, on.problem),))
    for component, moments in zip(push, load.moments, strict=True):
        np.add.at(component, load.nodes, moments * load.measure)
    if text in tools:
        component, place = tools[text]
        if on.problem.order == 1 and on.problem.obstacles[on.problem.tools[place]].level is not None:
            raise NotCertifiableError("errors are estimated of round tools at order 2")
        push[component, space.n_nodes + place] = 1.0
    acting = load.balanced * load.measure, push[:, space.n_nodes :]
    return Quantity(float(np.sum(push * on.u)), on.dual(gap, push), acting)


def of_contact(problem: ContactProblem, *kinds: str) -> tuple[str, ...]:
    """Quantities of each contact boundary."""
    parts = (part.boundary for part in problem.obstacles)
    return tuple(f"{kind}({name})" for name in parts if isinstance(name, str) for kind in kinds)


def of_tools(problem: ContactProblem) -> dict[str, tuple[int, int]]:
    """Displacements of tools that a force moves: component, and number of the tool."""
    return {
        f"tool_{axis}({problem.obstacles[number].boundary})": ("xy".index(axis), place)
        for place, number in enumerate(problem.tools)
        for axis in problem.obstacles[number].move or ""
    }


def unknown(problem: ContactProblem) -> tuple[str, ...]:
    """What is asked for by default: how far forces move tools, the force of other contact, or the energy."""
    texts = list[str]()
    for each in problem.obstacles:
        if each.force is not None:
            texts += [
                f"tool_{axis}({each.boundary})" for axis, part in zip("xy", each.force, strict=True) if part
            ]
        elif isinstance(each.boundary, str):
            texts += [f"resultant({each.boundary})"]
    return tuple(texts) or (ENERGY,)


def estimates(on: OnMesh, texts: Sequence[str]) -> list[Estimate]:
    """Estimates of quantities on a mesh, by a field in equilibrium or else by richer displacements.

    Raises a NotCertifiableError or a ProblemError where neither is known.
    """
    try:
        return by_equilibrium(on, texts)
    except NotCertifiableError:
        return _by_richer(on, texts)


def by_equilibrium(on: OnMesh, texts: Sequence[str]) -> list[Estimate]:
    """Estimates by a field in equilibrium; a NotCertifiableError where none is known."""
    problem, state = on.problem, on.state
    turning = (part.level is not None for part in problem.obstacles)
    if problem.motion.curves or problem.axisymmetric or any(turning):
        raise NotCertifiableError(
            "body or foundation are curved, or r times a stress of a displacement is no polynomial"
        )
    if any(np.any(part.partner == np.arange(on.space.n_nodes)) for part in on.space.contact_sets):
        raise NotCertifiableError("no displacement opens a crack at its end")
    skeleton = on.skeleton
    stresses = contact_stresses(on.space, on.nodes, state.normal_force, state.tangential_force)
    fields, _, balance, _, correction = corrected(problem, skeleton, Guess(on.u, *stresses))
    assembled, system, solved = balance.assembled, balance.assembled.system, balance.solved
    if solved.status is not Status.CONVERGED:
        raise NotCertifiableError("the contact problem of the traces was not solved")
    strains = fields.energy(correction)
    free, gained, defect = ~assembled.held, float(np.sum(strains)), np.sqrt(2 * strains)

    def gaps(u: Array) -> Array:
        return system.normals @ assembled.of_displacement(u)[free]

    def estimate(text: str) -> Estimate:
        computed, w, load, part, weights, rest = _quantity(text, on)
        if text == ENERGY:
            value = computed - gained * problem.has_energy  # else no energy is least
            return Estimate(value, gained, computed, defect**2, half=gained / 2)
        if load is None and part is None:
            return Estimate(computed, np.nan, computed, defect**2, touching=on.ends(True).shape[1])
        push, gap = np.zeros(system.load.size), np.zeros(system.offset.size)
        if load is not None:
            edges, tools = load
            push = turned(assembled.turn, edges, 0 * assembled.conditions.inside.offset, tools)[free]
        elif part is not None:
            nodes, raised, along = on.space.nodes_of(contact_edges(problem, part.obstacle)), 0 * w, w.copy()
            raised[:, nodes] = np.multiply.outer(part.obstacle.normal, weights[nodes])[: len(w)]
            given = np.setdiff1d(nodes, part.nodes)
            along[:, given], gap = raised[:, given], -gaps(raised)
        traces = np.zeros(free.size)
        traces[free] = system.response(solved.active, push, gap)
        other = fields.of_traces(balance.traces + assembled.by_element(traces)) - correction
        own = of_displacement(fields.element, fields.law, skeleton, w)
        other -= own
        pressing = system.normals @ (system.stiffness @ traces[free] - push)
        closing = (pressing * solved.active.touching) @ system.offset  # computed gaps
        beyond = 0.0
        if part is None:
            products = fields.energy(correction + other) - fields.energy(correction - other)
            value = computed + np.sum(products) / 2 + closing
        else:
            slip = system.tangents @ assembled.of_displacement(along)[free]
            follows = solved.active.sliding * (system.bound(solved.normal_force) - system.slip_bound)
            value = solved.normal_force @ gaps(along) - follows @ slip
            beyond = -solved.normal_force @ gap - value
            if slip.size:
                value += (solved.tangential_force + follows) @ slip + on.work_of_bounds(w)
            value += BETWEEN * beyond + rest
        local = defect * np.sqrt(fields.energy(other))
        # by the best s of :func:`rmesh_nlp.certificate.forces.slope_bounds`
        half = 2 * np.sqrt(gained * np.sum(fields.energy(own))) if problem.has_energy else np.nan
        value = computed + SHARE * (value - computed)
        doubt = max(abs(beyond), abs(closing)) / 2
        return Estimate(value, np.hypot(value - computed, doubt), computed, local, half=half, doubt=doubt)

    return [estimate(text) for text in texts]


def _by_richer(on: OnMesh, texts: Sequence[str]) -> list[Estimate]:
    """By the solution of order 2 on the same mesh, of one that has this order on the mesh refined once."""
    problem = on.problem
    raised = replace(problem, mesh=relocated_mesh(problem.mesh, on.nodes), reference=None, order=2)
    richer, times = (raised, 1) if problem.order == 1 else (refined(raised), LEFT)
    finer = OnMesh.of(on.solver(richer))

    def lacking(fine: Array, coarse: Array) -> Array:
        # vertices of the mesh refined once are the nodes of order 2
        same = Guess(coarse, coarse[0], coarse[0]).on_refined(on.space, finer.space).displacement
        return finer.space.values(fine - same)

    energies = partial(strain_energies, richer, finer.nodes)
    defect = lacking(finer.u, on.u)
    own = energies(defect)

    def estimate(text: str) -> Estimate:
        coarse, fine, work, touching = _quantity(text, on), _quantity(text, finer), own, 0
        if coarse.dual is not on.u:
            other = lacking(fine.dual, coarse.dual)
            work = (energies(defect + other) - energies(defect - other)) / 4
        local = np.abs(np.sum(np.reshape(work, (-1, problem.mesh.nelements)), axis=0))
        # of what has both signs half the sum counts: what cancels here need not on finer meshes
        error = max(times * abs(fine.value - coarse.value), np.sum(local))
        if work is own and text != ENERGY:
            error, touching = np.nan, on.ends(True).shape[1]  # the rate is not known
        return Estimate(fine.value, error, coarse.value, local, touching=touching)

    return [estimate(text) for text in texts]
