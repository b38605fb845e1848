"""A lower and an upper bound of the least energy, from a displacement on a mesh.

With a field sigma in equilibrium with the simplified load (f_h, g_h), pressure p >= 0 and friction
|q| <= s, every admissible displacement v obeys

    J(v) = D(sigma) - (f - f_h, v) - (g - g_h, v) + 1/2 |eps(v) - C^-1 sigma|^2 + contact(v),
    D(sigma) = -1/2 |C^-1 sigma|^2 + int R . u_D - int p offset,
    contact(v) = int p (n . v + offset) + int (s |v_t| + q v_t)   >= 0.

The simplified loads are the best approximations by polynomials of the degree of the field's tractions, which
is the order of the displacements. So on each element such a polynomial w can be taken off v in
the load terms, which are then bounded by ``r_T |v - w|_T``. With that w whose strain is the mean of
``C^-1 sigma``, or the computed displacement if that is closer,

    min J >= D(sigma) - sum_T (eta_T r_T + r_T^2 / 2),

eta_T the distance of sigma from the stress of w on the element, in the energy norm. If u is admissible, J(u)
is the upper bound, and half the square of the error of u in the energy norm is at most the difference.

The lower bound holds whatever mesh the field in equilibrium lives on. On few elements the field's own error
adds a fifth to a half of the true gap for elastic problems, on the mesh refined once a third of that or less.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.assessment.energy import friction_energy
from rmesh_nlp.certificate import NotCertifiableError
from rmesh_nlp.certificate.conditions import Conditions
from rmesh_nlp.certificate.equilibration import Balance, EquilibratedField, Guess, equilibrated
from rmesh_nlp.certificate.oscillation import oscillation
from rmesh_nlp.certificate.polynomials import mass, moments
from rmesh_nlp.certificate.skeleton import Skeleton, skeleton_of
from rmesh_nlp.evaluation import PROVED, Array, magnitude
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.problem.body import Edges

DOUBT = 1e-2
"""Largest part of the gap between the bounds that may rest on doubtful quadrature."""

DOUBTFUL = "two quadrature rules disagree about a load, a traction or an obstacle that is not smooth"

UNKNOWN = "a load, a traction or an obstacle jumps or kinks along a line that is not known with certainty"

BENT = "the given displacement is not of the order of displacements on every edge, and held at nodes only"

AT_NODES = "the gap holds at the nodes only"
"""What is said of contact until the energy of an admissible displacement is the bound."""

FEW = 500
"""Triangles up to which the equilibration is refined once unless asked otherwise: it takes less than a
tenth of a second there."""


@dataclass(frozen=True)
class Bracket:
    """Bounds of the least energy by one displacement on one mesh.

    What the elements add to ``upper - lower`` is not negative if the displacement is admissible. A bound is
    guaranteed where nothing stands in the way.
    """

    lower: float
    upper: float
    lower_faults: tuple[str, ...]  # what stands in the way of a guarantee
    upper_faults: tuple[str, ...]
    local: Array  # (elements,), what each element adds to upper - lower
    field: Array  # (2 or 3, elements), mean equilibrated flux, or stress xx, yy, xy
    norm: float  # energy norm of the displacement
    residual: float  # largest violation of equilibrium, relative to the largest force
    distance: float = 0.0  # in the energy norm, from the displacement whose energy ``upper`` is

    @property
    def gap(self) -> float:
        """Between the bounds; NaN where they contradict each other."""
        return self.upper - self.lower if self.lower <= self.upper else np.nan

    @property
    def why(self) -> tuple[str, ...]:
        """All faults, with the bound that they are of."""
        sides = ("lower", self.lower_faults), ("upper", self.upper_faults)
        return tuple(f"{side}: {fault}" for side, faults in sides for fault in faults)


def bracket(problem: ContactProblem, nodes: Array, guess: Guess) -> Bracket:
    """Bounds of the least energy of a problem, by a guess computed with its nodes at ``nodes`` (2, nodes).

    The better the guess the closer the bounds, but any one is valid. Raises NotCertifiableError for a kind of
    problem for which no certificate is known.
    """
    if not problem.has_energy:
        raise NotCertifiableError("with Coulomb friction no energy is minimised")
    skeleton, u = skeleton_of(problem, nodes), guess.displacement
    field = equilibrated(problem, skeleton, guess)
    conditions, load = field.balance.assembled.conditions, field.load
    traction, inside = conditions.traction, conditions.inside
    balance, strain, computed = field.balance, float(np.sum(field.energy)), float(np.sum(field.computed))
    edge = skeleton.lengths[conditions.contact]
    on_edges = balance.pressure * edge
    on_elements = balance.inside * skeleton.areas[inside.elements]
    pressure_work = float(np.sum(on_edges * conditions.offset) + np.sum(on_elements * inside.offset))
    residual = float(np.max([field.residual, edge_residual(skeleton, conditions, field)]))
    rounding = strain + field.scale * magnitude(u) + abs(balance.reaction_work) + abs(pressure_work)
    rounding *= max(residual, 1e-15)
    doubt = (  # what quadrature of all data may have changed in the bounds
        load.doubtful_work(u)
        + traction.doubtful_work(u)
        + float(np.sum(on_edges * conditions.offset_doubt) + np.sum(on_elements * inside.offset_doubt))
        + abs(balance.reaction_work) * conditions.given_doubt
        + 2 * magnitude(u) * float(np.sum((on_edges + abs(balance.friction) * edge) * conditions.axes_doubt))
    )
    unmet = traction.remainder + turning(skeleton, conditions, balance)
    r = oscillation(skeleton, load.remainder, unmet, field.fields.law.gradient_by_energy)
    spread = field.variation * r + r**2 / 2
    dual = balance.reaction_work - strain - pressure_work
    lower = float(dual - np.sum(spread) - doubt - rounding)
    friction = _friction_work(skeleton, conditions, u)
    on_tools = sum(u[:, tool] @ force for tool, force in skeleton.space.forces)
    upper = float(computed - load.work(u) - traction.work(u) - on_tools + np.sum(friction))
    through = _slack(balance, u) * edge + friction
    local = field.defect**2 / 2 + spread
    local += np.bincount(skeleton.owner[conditions.contact], through, local.size)
    gap = inside.sign * moments(u[0, skeleton.space.elements[:, inside.elements]], 3)
    local[inside.elements] += np.sum(on_elements * (gap + inside.offset), axis=0)
    of_both = {
        DOUBTFUL: not doubt <= max(DOUBT * abs(upper - lower), PROVED * strain),
        UNKNOWN: not (conditions.is_certain and load.is_certain),
    }
    out = f"the field is out of equilibrium by {residual:.1e} of the largest force"
    of_lower = {out: not residual <= PROVED, **of_both}
    of_upper = {BENT: conditions.given_error > PROVED, AT_NODES: bool(problem.obstacles), **of_both}
    lower_faults, upper_faults = (
        tuple(fault for fault, holds in each.items() if holds) for each in (of_lower, of_upper)
    )
    norm = float(np.sqrt(2 * computed))
    return Bracket(lower, upper, lower_faults, upper_faults, local, field.mean, norm, residual)


def _friction_work(skeleton: Skeleton, conditions: Conditions, u: Array) -> Array:
    """(contact edges,) work of the friction bound on the slip of a displacement ``u`` (components, nodes)."""
    work, sets = np.zeros(conditions.contact.size), skeleton.space.contact_sets
    for part in conditions.parts:
        if part.obstacle.friction_law:
            jump = sets[part.number].relative(u)[:, skeleton.along[:, part.edges]]
            work[part.place] = friction_energy(Edges(skeleton.body, part.edges), part.obstacle, jump)[0]
    return work


def _slack(balance: Balance, u: Array) -> Array:
    """(contact edges,) mean work of pressure on the gap and of friction on the slip."""
    assembled = balance.assembled
    traces, (offset, inside) = assembled.of_displacement(u), (assembled.conditions.offset, balance.inside)
    gap, slip = (
        (rows @ traces)[inside.size :].reshape(offset.shape)
        for rows in (assembled.normals, assembled.tangents)
    )
    return np.sum(balance.pressure * (gap + offset) + balance.friction * slip, axis=0)


def turning(skeleton: Skeleton, conditions: Conditions, balance: Balance) -> Array:
    """(edges,) L2 norm of what the field's polynomials leave of contact stresses where normals turn."""
    result, products = 0 * skeleton.lengths, mass(skeleton.space.order, 2)
    for part in conditions.parts:
        if part.obstacle.level is not None:
            own = np.stack([balance.friction, balance.pressure])[..., part.place]
            met = np.einsum("ejalc,aje->cle", conditions.axes[part.place], own)
            whole, met = (np.einsum("aje,jl,ale->e", each, products, each) for each in (own, met))
            square = skeleton.lengths[part.edges] * np.maximum(whole - met, 1e-15 * whole)
            result[part.edges] = np.sqrt(square)
            result[part.others] = np.sqrt(square)[: part.others.size]
    return result


def edge_residual(skeleton: Skeleton, conditions: Conditions, field: EquilibratedField) -> float:
    """Largest violation of equilibrium on the edges and of the laws on the contact boundary.

    Relative to the scale of forces. Sums of tractions, less the applied ones and
    those of contact, must vanish along every edge in every component that is not given, forces on tools too;
    contact must press and friction stay within its bound.
    """
    balance, edge = field.balance, skeleton.lengths[conditions.contact]
    assembled = balance.assembled
    on_edges = assembled.numbers[:, : len(field.forces.T)]
    total = np.bincount(on_edges.ravel(), field.forces.ravel(), assembled.held.size)
    total = assembled.turn @ total - assembled.applied
    pressing, along = (part[balance.inside.size :] for part in (assembled.normals, assembled.tangents))
    total -= pressing.T @ (balance.pressure * edge).ravel() + along.T @ (balance.friction * edge).ravel()
    slipping = np.abs(balance.friction) - conditions.friction
    parts = (np.abs(np.where(assembled.held, 0.0, total)), -balance.pressure * edge, slipping * edge)
    return float(np.max([np.max(part, initial=0.0) for part in parts])) / field.scale


def refined_bracket(
    problem: ContactProblem, nodes: Array, guess: Guess, refinements: int | None = None
) -> Bracket:
    """Bounds as of :func:`bracket`, by an equilibration on a finer mesh; per element of the given mesh.

    Each of the ``refinements`` makes four triangles of one; by default there is one on up to ``FEW``
    triangles, else none.
    """
    count = problem.mesh.nelements
    if refinements is None:
        refined = refined_bracket(problem, nodes, guess, int(count <= FEW))
        # on needles rounding grows with refinement
        plain = bracket(problem, nodes, guess) if refined.lower_faults and count <= FEW else refined
        return refined if plain.lower_faults else plain
    if refinements == 0:
        return bracket(problem, nodes, guess)
    mesh = relocated_mesh(problem.mesh, nodes)
    finer = replace(problem, mesh=mesh, motion=Motion(None))
    for _ in range(refinements):
        coarse, finer = finer, replace(finer, mesh=finer.mesh.refined(1))
        guess = guess.on_refined(DisplacementSpace(coarse), DisplacementSpace(finer))
    refined = bracket(finer, finer.mesh.p, guess)
    children = 4**refinements
    return replace(
        refined,
        local=refined.local.reshape(children, count).sum(axis=0),
        field=refined.field.reshape(-1, children, count).mean(axis=1),
    )
