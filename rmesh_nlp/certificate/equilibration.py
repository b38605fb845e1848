"""The field in equilibrium whose dual energy is largest, by one sparse positive definite system.

Stresses (or fluxes) live on the elements; traces of the displacement on the edges are the
multipliers of equilibrium between them. Eliminating the stresses leaves

    min 1/2 W^T S W - F^T W + sum b |T W|   with   N W + gamma >= 0

in the traces W alone, a contact problem of the same form as that of the nodes, whose minimum is
the largest dual energy. Its multipliers are the contact forces. Any non-negative ones, with
friction within its bound, give a lower bound of the energy, the best ones the highest. They are found
by an active set that begins with the contact of the computed solution.

Traces are counted from those of the computed displacement: where it is close to the solution they are
small, and so is the rounding of stresses, which would else be differences of large numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from skfem import MeshTri

from rmesh_nlp.certificate import NotCertifiableError
from rmesh_nlp.certificate.conditions import conditions_of
from rmesh_nlp.certificate.fields import TraceFields, element_of, law_of, of_displacement
from rmesh_nlp.certificate.hybrid import Hybrid, hybrid
from rmesh_nlp.certificate.integrals import Loads, body_forces
from rmesh_nlp.certificate.polynomials import moments
from rmesh_nlp.certificate.skeleton import Skeleton
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.factorisation import factorised
from rmesh_nlp.contact.system import ActiveSet, Equilibrium
from rmesh_nlp.evaluation import PROVED, ROUNDING, Array, Index, magnitude
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.fem.stress import strain_energies
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem


@dataclass(frozen=True)
class Guess:
    """What the computed solution knows: where the equilibration begins; vertices come first, then edges."""

    displacement: Array  # (components, nodes and tools) coefficients
    pressure: Array  # (nodes,) coefficients, of contact
    friction: Array  # (nodes,)

    def on_refined(self, coarse: DisplacementSpace, fine: DisplacementSpace) -> Guess:
        """From a mesh to the mesh refined once, whose new vertices halve the edges; numbered as these are.

        The coefficient between two points P and Q is the blossom of the polynomial there: linear in either
        point, and between vertices of the mesh the coefficient of their edge.
        """
        mesh, finer = coarse.problem.mesh, fine.problem.mesh
        node = ends = _ends(mesh)
        if coarse.order == 2:
            P, Q = _ends(finer)
            first, second = (part.ravel() for part in np.broadcast_arrays(ends[:, None, P], ends[None, :, Q]))
            node, between = first.astype(np.int64), first != second
            node[between] = coarse.nodes_at(first[between], second[between])
            node = node.reshape(4, -1)
        values = self.displacement, self.pressure, self.friction
        displacement, *stresses = (part[..., node].mean(axis=-2) for part in values)
        return Guess(np.hstack([displacement, self.displacement[:, coarse.n_nodes :]]), *stresses)


def _ends(mesh: MeshTri) -> Index:
    """Between which vertices each node of order 2 is: a vertex between itself and itself."""
    return np.hstack([np.tile(np.arange(mesh.p.shape[1]), (2, 1)), mesh.facets])


@dataclass(frozen=True)
class Balance:
    """The field in equilibrium, as far as edges see it."""

    traces: Array  # (elements, k) of each element, in Cartesian components, counted from the base
    pressure: Array  # (k, contact edges) coefficients of Bernstein's polynomials along the contact edges
    friction: Array  # the same; zero in a scalar problem
    reaction_work: float  # of the reactions on the given displacements
    inside: Array  # (functions, m) coefficients of the pressure of an obstacle in the interior
    assembled: Hybrid
    solved: Equilibrium  # of its contact problem


@dataclass(frozen=True)
class EquilibratedField:
    """A flux or stress in equilibrium, element by element; norms are energy norms."""

    mean: Array  # (2 or 3, elements), of the flux, or of the stress xx, yy, xy
    computed: Array  # (elements,), strain energy of the computed displacement
    energy: Array  # (elements,), complementary energy of this field
    defect: Array  # (elements,), distance between this field and that of the computed displacement
    variation: Array  # (elements,), distance from a field that a polynomial of the loads' degree has
    forces: Array  # (elements, traces), coefficients of the tractions times the edge's length
    scale: float  # largest of these, at least what rounding makes of the displacement over PROVED
    balance: Balance
    residual: float  # largest violation of equilibrium inside elements, relative to the scale of forces
    fields: TraceFields
    load: Loads


def corrected(
    problem: ContactProblem, skeleton: Skeleton, guess: Guess
) -> tuple[TraceFields, Loads, Balance, Array, Array]:
    """The field of largest dual energy, as that of the computed displacement and what it adds to this.

    Raises NotCertifiableError for a kind of problem for which no field in equilibrium is known.
    """
    if any(law.varies and not law.axisymmetric for law in problem.laws):
        raise NotCertifiableError("of a law whose energy varies no stress in equilibrium is known")
    if np.any(problem.on_axis):
        raise NotCertifiableError(
            "a body of revolution that meets its axis has no bounds: r times its stress is 0 there"
        )
    if problem.origin is not None and problem.frictional:
        raise NotCertifiableError("friction counts slip from an earlier load step")
    if problem.point_loads:
        raise NotCertifiableError("the energy under a point load has no lower bound")
    conditions, load = conditions_of(problem, skeleton), body_forces(problem, skeleton)
    element, law, u = element_of(problem), law_of(problem, skeleton), guess.displacement
    start = 0 * u if problem.axisymmetric else u  # r times a hoop strain is no polynomial
    computed = of_displacement(element, law, skeleton, start)
    lacking = load.balanced + element.pieces.divergence(computed, skeleton.corners)[:, 0, :1]
    fields = TraceFields(element, skeleton, law, lacking, conditions.inside.elements.size > 0)
    balanced = balance(hybrid(conditions, fields, computed, start), guess)
    return fields, load, balanced, computed, fields.of_traces(balanced.traces)


def equilibrated(problem: ContactProblem, skeleton: Skeleton, guess: Guess) -> EquilibratedField:
    """The field of :func:`corrected`, measured element by element."""
    fields, load, balanced, computed, correction = corrected(problem, skeleton, guess)
    u, field, pushing = guess.displacement, computed + correction, load.balanced.copy()
    inside = balanced.assembled.conditions.inside
    pushing[0][:, inside.elements] += inside.sign * balanced.inside
    mean, forces, energy = fields.mean(field), fields.forces(field), fields.energy(field)
    if problem.axisymmetric:
        strain = strain_energies(problem, skeleton.nodes, skeleton.space.values(u))
        traces = balanced.assembled.by_element(balanced.assembled.of_displacement(u))[:, : len(forces.T)]
        within = moments(u[:, skeleton.space.elements], 3) * skeleton.areas
        work = np.sum(forces * traces, axis=1) + np.sum(pushing * within, axis=(0, 1))
        variation = defect = np.sqrt(2 * np.maximum(energy + strain - work, 0.0))
    else:
        strain, defect = fields.energy(computed), np.sqrt(2 * fields.energy(correction))
        variation = np.sqrt(2 * fields.energy(field - mean))
    # where the best field vanishes its forces are rounding
    softest = np.min(np.max(np.abs(fields.stiffness), axis=(1, 2)))
    rounding = 8 * np.finfo(float).eps * float(softest) * magnitude(u)
    scale = max(magnitude(forces), rounding / PROVED, 1e-300)
    return EquilibratedField(
        mean=mean[: len(u) + 1] / problem.measured(skeleton.corners.mean(axis=1)),
        computed=strain,
        energy=energy,
        defect=defect,
        variation=np.minimum(variation, defect),
        forces=forces,
        scale=scale,
        balance=balanced,
        residual=fields.imbalance(field, pushing, scale),
        fields=fields,
        load=load,
    )


def balance(assembled: Hybrid, guess: Guess) -> Balance:
    """Equilibrate the elements with each other and with contact: solve the contact problem of the traces.

    Its active set begins with the contact of the guess. Where that fails, the forces that it ends with give a
    bound too, if not the best.
    """
    skeleton, conditions, system = assembled.skeleton, assembled.conditions, assembled.system
    obstacle = conditions.inside
    space, edge = skeleton.space, skeleton.lengths[conditions.contact]
    along = skeleton.along[:, conditions.contact]
    inside = guess.pressure[space.elements[:, obstacle.elements]].T.ravel()
    pressure, friction = (values[along] * edge for values in (guess.pressure, guess.friction))
    # at order 2 contact of the traces ends before the edges on which that of the nodes does
    pressure[np.isin(along, along[:, (np.min(pressure, axis=0) <= 0) & (space.order > 1)])] = 0.0
    pressing = np.append(inside, pressure)
    touching, bound = pressing > 0, system.bound((1 - ROUNDING) * pressing)
    # all of an edge slides
    slides = np.any(np.abs(friction) >= bound[inside.size :].reshape(friction.shape), axis=0)
    sliding = np.append(0 * inside, 0 * friction - slides * np.sign(np.sum(friction, axis=0)))
    friction = np.append(0 * inside, friction)
    solved = solve(system, ActiveSet(touching, sliding.astype(np.int8)))
    if solved.status is not Status.CONVERGED:
        solved = solve(system)
    force, friction = np.maximum(solved.normal_force, 0.0), solved.tangential_force
    u = solved.u
    if solved.status is not Status.CONVERGED:
        if system.rigid is not None:
            raise NotCertifiableError("no stress in equilibrium was found for what only contact holds")
        friction = np.clip(friction, -bound, bound)
        push = system.normals.T @ force + system.tangents.T @ friction
        u = factorised(system.stiffness)(system.load + push)
    shape, held = conditions.offset.shape, assembled.held
    traces = assembled.base.copy()
    traces[~held] += u
    W = traces - assembled.start
    push = assembled.normals.T @ force + assembled.tangents.T @ friction
    reaction = (assembled.matrix @ W - assembled.load - push)[held] @ traces[held]
    (inside, pressure), (_, friction) = (np.split(part, [obstacle.offset.size]) for part in (force, friction))
    return Balance(
        traces=assembled.by_element(W),
        pressure=pressure.reshape(shape) / edge,
        friction=friction.reshape(shape) / edge,
        reaction_work=float(reaction),
        inside=inside.reshape(obstacle.offset.T.shape).T / skeleton.areas[obstacle.elements],
        assembled=assembled,
        solved=solved,
    )
