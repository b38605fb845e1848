"""How far a solution is from the exact one, before and after the relocation: bounds, not estimates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from rmesh_nlp.assessment.admissible import Admissible, admissible
from rmesh_nlp.assessment.energy import load_vector
from rmesh_nlp.certificate import NotCertifiableError
from rmesh_nlp.certificate.bracket import BENT, UNKNOWN, Bracket, refined_bracket
from rmesh_nlp.certificate.conditions import is_seen
from rmesh_nlp.certificate.equilibration import Guess
from rmesh_nlp.certificate.estimates import (
    ENERGY,
    OnMesh,
    by_equilibrium,
    estimates,
    of_contact,
    of_tools,
    pressure_integral,
    split,
)
from rmesh_nlp.certificate.forces import force_bounds, slope_bounds, within
from rmesh_nlp.certificate.skeleton import same_domain
from rmesh_nlp.contact.active_set import solve
from rmesh_nlp.contact.system import ContactSystem
from rmesh_nlp.errors import BadInputError, expect, expect_list, one_line
from rmesh_nlp.evaluation import ROUNDING, Array
from rmesh_nlp.expressions import Expression
from rmesh_nlp.fem.contact_pressure import contact_stresses
from rmesh_nlp.fem.objective_text import load_of
from rmesh_nlp.fem.pressure import contact_on
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Motion, Traction
from rmesh_nlp.problem.body import Body
from rmesh_nlp.settings import ByName
from rmesh_nlp.solving.assessment import Assessment
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.parts import Bounds, Certificate
from rmesh_nlp.solving.solution import Solution
from rmesh_nlp.solving.state import State

POLYGON = (
    "a body with curves is certified as the polygon of its mesh, whose error is larger than that of "
    "displacements of order 2: take order = 1"
)


FAULTS = (ValueError, RuntimeError, np.linalg.LinAlgError)

CROSSED = "it contradicts the other one, so one of them is wrong"


def certify(
    solution: Solution, *, quantities: Sequence[str] = (), refinements: int | None = None
) -> Certificate:
    """Bound the least energy and the error of a solution in the energy norm.

    The contact problem is solved once more on the given mesh, for the bound before the relocation. The
    better of the two lower bounds serves both meshes if relocation left the domain as it was. Of a design the
    bounds before are those of the first one.

    Parameters
    ----------
    solution : Solution
        What was computed.
    quantities : sequence of str
        Linear ones that are bounded as well: "mean(top, -uy)", "boundary(top, x*ux)", and integrals of
        pressure times a weight, "pressure(bottom, x)". The resultants of the contact boundaries,
        "resultant(bottom)", and displacements of tools, "tool_y(top)", always are.
    refinements : int, optional
        How often the mesh is refined for the field that proves the lower bound; more make the bounds
        closer and cost four times as much each. By default once on small meshes, see
        :func:`rmesh_nlp.certificate.bracket.refined_bracket`.

    Raises
    ------
    NotCertifiableError
        If the problem is of a kind for which no certificate is known.
    ValueError
        If the solution has no displacement, because its mesh is invalid.
    BadInputError
        If a quantity is not linear in the displacement.
    """
    expect("solution", solution, Solution)
    expect_list("quantities", quantities, "texts")
    for text in quantities:
        expect("a quantity", text, str)
    return bounded(solution.assessment, quantities, refinements)


def bounded(
    assessment: Assessment, quantities: Sequence[str] = (), refinements: int | None = None
) -> Certificate:
    """The certificate of the two states of an assessment."""
    given, final = assessment.given, assessment.final
    if given.continuous is None or final.continuous is None:
        raise BadInputError(f"there is nothing to certify: the solution is {assessment.status.value}")
    problem = final.problem
    nodes, exact = final.mesh.p, _on_polygon(final, final.continuous)
    space, own, windows = exact.continuous.space, DisplacementSpace(problem), []  # refined, and not
    under: dict[str, Callable[[float], ContactProblem]] = {
        text: partial(_pressed, exact.problem, *at) for text, at in of_tools(problem).items()
    }
    parts = dict(zip(final.contact, space.contact_sets, strict=False))
    for text in dict.fromkeys((*map("resultant({})".format, parts), *quantities)):
        kind, name, expression = split(text)
        if kind in ("resultant", "pressure"):
            weight = Expression(expression) if kind == "pressure" else 1.0
            windows.append((text, parts.get(name) or contact_on(space, name), weight))
        elif text not in (*under, ENERGY):
            under[text] = partial(_loaded, exact.problem, load_of(text, problem))
    after = _bracket(final, exact, refinements)
    if problem.order == 2 and problem.motion.curves:  # what order 1 cannot do either is said before
        raise NotCertifiableError(POLYGON)
    before = after
    is_new = not np.array_equal(given.problem.mesh.t, problem.mesh.t)
    if is_new or not np.array_equal(nodes, given.mesh.p):
        before = _bracket(given, _on_polygon(given, given.continuous), refinements)
        # with a design they are bounds of two problems, and curves are polygons of two meshes
        if not (final.design or (is_new and problem.motion.curves)) and same_domain(problem, nodes):
            best = max((before, after), key=lambda bracket: (not bracket.lower_faults, bracket.lower))
            before, after = (
                replace(bracket, lower=best.lower, lower_faults=best.lower_faults)
                for bracket in (before, after)
            )
        if is_new:  # the elements of a file are those of the last mesh
            before = replace(before, local=np.full(problem.mesh.nelements, np.nan))
    is_one, before, after = before is after, _consistent(before), _consistent(after)
    why = after.why if is_one else (*after.why, *(f"given mesh: {reason}" for reason in before.why))
    bounds = dict[str, Bounds]()
    for text, part, weight in windows:
        if part.rows.size:  # not every gap is given
            same = own.contact_sets[part.number]
            value = pressure_integral(own, nodes, same, weight, final.equilibrium.normal_force)[0]
            is_known = not after.why and is_seen(weight, exact.body.edges_of(part.obstacle))
            low, high = force_bounds(exact, after.lower, part, weight)
            where = within(exact, after.lower, part, low) if is_known and not callable(weight) else None
            bounds[text] = Bounds(low, value, high, is_known, where)
    if ENERGY in quantities:
        bounds[ENERGY] = Bounds(after.lower, final.energy, after.upper, not after.why)
    bounds |= {text: _load_bounds(exact, after, more, refinements) for text, more in under.items()}
    # half the square of the admissible displacement's error is at most the gap between the bounds
    errors = [float(np.sqrt(2 * each.gap)) + each.distance for each in (before, after)]
    return Certificate(
        lower=after.lower,
        upper=after.upper,
        gaps=(before.gap, after.gap),
        error_bound_initial=errors[0],
        error_bound=errors[1],
        relative_initial=errors[0] / max(before.norm, 1e-300),
        relative=errors[1] / max(after.norm, 1e-300),
        guaranteed_lower=not after.lower_faults,
        guaranteed_upper=not after.upper_faults,
        guaranteed_initial=not before.why,
        why="; ".join(dict.fromkeys(why)),
        local=after.local,
        local_initial=before.local,
        field=after.field,
        residual=max(after.residual, before.residual),
        bounds=bounds,
    )


def _on_polygon(state: State, continuous: Admissible) -> Admissible:
    """The admissible displacement; a body with curves is certified as the polygon of its mesh."""
    if not state.problem.motion.curves:
        return continuous
    return admissible(replace(state.problem, mesh=state.mesh, motion=Motion(None)))


def _bracket(state: State, continuous: Admissible, refinements: int | None) -> Bracket:
    """Both bounds on one mesh, the upper one that of the displacement that is admissible."""
    u = DisplacementSpace(state.problem).coefficients(state.displacement)
    u = np.hstack([u, *([[x], [y]] for x, y in state.tools.values())])
    guess = Guess(u, state.pressure, state.tangential_stress)
    bracket = refined_bracket(state.problem, state.mesh.p, guess, refinements)
    return replace(with_upper(bracket, continuous), distance=_distance(u, bracket.norm, continuous))


def _distance(u: Array, norm: float, continuous: Admissible) -> float:
    """At most that of a displacement (components, nodes) from the admissible one, in the energy norm."""
    if u.shape != continuous.displacement.shape:  # on a mesh that was refined to make room
        return norm + float(np.sqrt(2 * continuous.strain))
    free = continuous.continuous.field.index.T.ravel() >= 0
    apart = (u - continuous.displacement).T.ravel()[free]
    return float(np.sqrt(max(apart @ (continuous.system.stiffness @ apart), 0.0)))


def with_upper(bracket: Bracket, continuous: Admissible) -> Bracket:
    """The bracket with the energy of an admissible displacement as its upper bound."""
    if continuous.status is not Status.CONVERGED or not continuous.continuous.is_open:
        return bracket
    faults = tuple(fault for fault in bracket.upper_faults if fault in (BENT, UNKNOWN))
    return replace(bracket, upper=continuous.energy + continuous.doubt, upper_faults=faults)


def _consistent(bracket: Bracket) -> Bracket:
    """The bracket, both of whose bounds are withdrawn where they contradict each other."""
    if bracket.why or bracket.lower <= bracket.upper:
        return bracket
    return replace(bracket, lower_faults=(CROSSED,), upper_faults=(CROSSED,))


def _loaded(problem: ContactProblem, load: Traction, s: float) -> ContactProblem:
    """The problem under a load more, s times."""
    scaled = tuple(lambda x, y, part=part: s * part(x, y) for part in load.value)
    return replace(problem, tractions=(*problem.tractions, Traction(load.boundary, scaled)))


def _pressed(problem: ContactProblem, component: int, place: int, s: float) -> ContactProblem:
    """The problem with a force s more on a tool, along x or y."""
    tools, number = list(problem.obstacles), problem.tools[place]
    force = np.array(tools[number].force)
    force[component] += s
    tools[number] = replace(tools[number], force=tuple(force))
    return replace(problem, obstacle=tuple(tools))


def _load_bounds(
    exact: Admissible, known: Bracket, under: Callable[[float], ContactProblem], refinements: int | None
) -> Bounds:
    """Bounds of the work of a load on the exact solution; ``under`` is the problem with s times that load."""
    on = exact.continuous
    nodes, field = on.body.nodes, on.field
    body = Body(under(1.0), nodes)
    push = load_vector(body, DisplacementSpace(body.problem))[0] - on.load
    free, u = field.index.T.ravel() >= 0, exact.displacement.T.ravel()

    def moved(s: float) -> ContactSystem:
        return replace(exact.system, load=exact.system.load + s * push[free])

    def upper(s: float) -> float:
        try:
            state = solve(moved(s), exact.state.active)
            stresses = contact_stresses(on.parts.space, nodes, state.normal_force, state.tangential_force)
            guess = Guess(field.values(state.u), *stresses)
            bracket = refined_bracket(under(s), nodes, guess, refinements)
        except FAULTS:  # nothing holds the body, or a tool
            return np.inf
        return -bracket.lower if set(bracket.lower_faults) <= set(known.lower_faults) else np.inf

    gap, value = max(known.upper - known.lower, ROUNDING * exact.strain), float(push @ u)
    flat = np.sqrt(gap * exact.strain) / max(float(np.abs(push) @ np.abs(u)), 1e-300)
    bent = exact.system.response(exact.state.active, push[free], 0 * exact.system.offset)
    bend = float(push[free] @ bent)
    low, high = slope_bounds(upper, -known.upper, gap, bend, flat)
    return Bounds(low, value, high, not known.why)


def certified(assessment: Assessment) -> tuple[Certificate | None, str | None]:
    """The certificate, or a remark that says why there is none."""
    try:
        return bounded(assessment), None
    except FAULTS as error:
        return None, f"no certificate: {one_line(error)}; --accuracy estimates errors"


def estimated(outer: Outer, final: State, certificate: Certificate | None = None) -> ByName:
    """The entry with estimates on a valid final mesh, where they take no finer one.

    They are those of contact forces and of the energy; the best known values obey bounds that are guaranteed.
    """
    problem, point, solver = final.problem, final.point, outer.contact
    assert point is not None
    texts = *of_contact(problem, "resultant"), ENERGY
    on = OnMesh(problem, final.mesh.p, solver.displacement, point.system, point.equilibrium)
    try:
        found = (estimates if problem.order == 1 else by_equilibrium)(on, texts)
    except FAULTS:
        return {}
    records = {text: one.record() for text, one in zip(texts, found, strict=True)}
    if certificate is not None:
        energy = Bounds(certificate.lower, final.energy, certificate.upper, certificate.is_guaranteed)
        for text, bounds in {ENERGY: energy, **certificate.bounds}.items():
            if text in records:
                records[text]["value"] = bounds.nearest(records[text]["value"])
    return {"estimates": records}
