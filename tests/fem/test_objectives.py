"""Outer objectives: values by hand and by scikit-fem, Taylor tests, and the text they are written in."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from skfem import Basis, ElementTriP1, ElementVector, FacetBasis, Functional

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.contact_terms import nodal_weights
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.problem import ContactProblem, Motion, Obstacle, PlaneStrain


def value(problem: ContactProblem, objective: Any, u: np.ndarray | None = None) -> float:
    """The objective at the given mesh with nodal displacements u, zero by default."""
    found = discretise(problem)
    rel = relocation(found)
    groups = parse_objective(objective).groups(problem, rel.mesh_map.positions, rel.displacement, rel.slip)
    x = np.zeros(rel.nlp.n_x)
    if u is not None:
        state = ContactSolver(found).displacement
        given = state.values(np.zeros(rel.n_u))
        columns = [(state.values(e) - given).ravel() for e in np.eye(rel.n_u)]
        free = np.linalg.lstsq(np.column_stack(columns), (u - given).ravel(), rcond=None)[0]
        x[rel.n_q : rel.n_q + rel.n_u] = free
        np.testing.assert_allclose(state.values(free), u, atol=1e-12)
    return float(sum(np.sum(part) for part in element_values(groups)(x)))


@pytest.fixture(scope="module")
def plate() -> ContactProblem:
    """(0, 2) x (0, 1), so that lengths are not 1; nothing is held at the right."""
    mesh = rm.shapes.rectangle(3, 2, x=(0, 2)).with_subdomains({"left half": lambda x: x[0] < 0.5})
    return ContactProblem(
        mesh, PlaneStrain(1.0, 1.0), ("left",), Obstacle("bottom", (0.0, 1.0), 0.0), Motion(0.01)
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("body(x**5*y**3)", 2**6 / 6 / 4),  # degree 8: exact
        ("body(1)", 2.0),
        ("boundary(top, x**8)", 2**9 / 9),
        ("boundary(right, y**8 + 2)", 1 / 9 + 2),
        ("mean(top, x**8)", 2**8 / 9),
        ("mean(top, 3)", 3.0),
        ("2*body(x) + mean(top, x)", 2 * 2 + 1),
        ("-body(x)", -2.0),
        ("-1.5*body(x)", -3.0),
        ("1e+1*body(x)+2e-1*body(y)", 20 + 0.2),
        ("1.e+1*body(x)", 20.0),
        ("9e+0*body(x)+1.E-0*body(y)", 19.0),
        ("mean(top, hypot(3*x, 4*x)) + body(1)", 5 + 2),
        ("body(x+y*(x-(1)))", 2 + 1 / 2 * (2 - 2)),
        ("body(2*(x + 1e-3))", 4 + 4e-3),
        (" body( x ) ", 2.0),
        ("body(y)", 1.0),
        ("boundary(bottom, nx - 2*ny)", 4.0),
        ("boundary(left, -nx*y)", 0.5),
    ],
)
def test_integrals_over_a_plate_by_hand(plate: ContactProblem, text: str, expected: float) -> None:
    assert value(plate, text) == pytest.approx(expected, rel=1e-11)


def test_integrals_of_a_displacement_and_its_slopes_by_hand(plate: ContactProblem) -> None:
    x = plate.mesh.p[0]
    u = np.stack([0.3 * x, -0.2 * x])
    assert value(plate, "body(ux_x + 10*uy_x + 100*ux_y + 1000*uy_y)", u) == pytest.approx(2 * (0.3 - 2))
    assert value(plate, "body(ux*uy)", u) == pytest.approx(-0.06 * 8 / 3)
    assert value(plate, "boundary(top, ux - uy)", u) == pytest.approx(0.5 * 2)
    assert value(plate, "node(2, 1, 10*ux + uy + 100*y)", u) == pytest.approx(6 - 0.4 + 100)


def test_densities_on_a_subdomain_and_functions_of_nodes(plate: ContactProblem) -> None:
    part = rm.quantities.body_integral(lambda x, y, u, slope: x, subdomain="left half")
    elements = plate.mesh.subdomains["left half"]
    centres = plate.mesh.p[:, plate.mesh.t[:, elements]].mean(axis=1)
    (a, b, c) = (plate.mesh.p[:, plate.mesh.t[k, elements]] for k in range(3))
    areas = np.abs((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]) / 2
    assert value(plate, part) == pytest.approx(float(areas @ centres[0]), rel=1e-12)
    last = plate.mesh.p.shape[1] - 1
    for node in (0, last):
        position = value(plate, rm.quantities.nodal([node], lambda X, u: X[0, 0] + 10 * X[1, 0]))
        assert position == pytest.approx(plate.mesh.p[0, node] + 10 * plate.mesh.p[1, node])
    for nodes in ([], [-1], [last + 1], [0, last + 1]):
        with pytest.raises(ValueError, match=f"between 0 and {last}"):
            value(plate, rm.quantities.nodal(nodes, lambda X, u: X[0, 0]))


def test_a_point_is_a_node_within_a_millionth_of_the_mesh(plate: ContactProblem) -> None:
    for off, found in ((0.0, True), (1.9e-6, True), (2.1e-6, False)):
        text = f"node({2 - off!r}, 1, x)"
        if found:
            assert value(plate, text) == pytest.approx(2)
        else:
            with pytest.raises(ValueError, match="no node at"):
                value(plate, text)


def test_a_function_of_several_values_and_unknown_names_are_refused(plate: ContactProblem) -> None:
    with pytest.raises(ValueError, match=r"one value, got one of shape \(2, 1\)"):
        value(plate, rm.quantities.nodal([0, 1], lambda X, u: X[:, 0]))
    with pytest.raises(ValueError, match="no subdomain 'soft': choose from left half"):
        value(plate, rm.quantities.body_integral(lambda *_: 1, subdomain="soft"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("inf*quality", "must be positive and finite"),
        ("nan*quality", "must be positive and finite"),
        ("0*body(x)", "must be positive and finite"),
        ("-0.5*quality", "must be positive"),
        ("x*quality", "'x' in .* is not a number"),
        ("body", "unknown objective 'body'"),
        ("body)x(", "unknown objective"),
        ("body(x", "unknown objective"),
        ("volume(x)", "unknown objective"),
        ("body(x, y)", r"expected body\(EXPR\)"),
        ("body()", r"expected body\(EXPR\)"),
        ("boundary(top)", r"expected boundary\(NAME, EXPR\)"),
        ("mean(top, )", r"expected mean\(NAME, EXPR\)"),
        ("mean(top, x, y)", r"expected mean\(NAME, EXPR\)"),
        ("node(1, x)", r"expected node\(X, Y, EXPR\)"),
        ("node(a, 1, x)", "'a' is not a number"),
        ("node(inf, 1, x)", "'inf' is not a finite number"),
        ("peak-pressure(bottom)", "expected peak-pressure"),
        ("peak-pressure(bottom, 1, 4, 5)", "expected peak-pressure"),
        ("peak-pressure(bottom, inf)", "not a finite number"),
        ("peak-pressure(bottom, 0)", "must be positive, got 0"),
        ("peak-pressure(bottom, 1, 4.5)", "whole number, got 4.5"),
        ("boundary(top, u_x)", "unknown name 'u_x'"),
        ("body(nx)", "unknown name 'nx'"),
        ("node(0, 0, nx)", "unknown name 'nx'"),
    ],
)
def test_what_is_wrong_with_a_text_is_said(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parse_objective(text)


def test_a_reference_or_an_exponent_of_no_sense_is_refused() -> None:
    for reference in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="must be positive"):
            rm.quantities.peak_pressure("bottom", reference)
    with pytest.raises(ValueError, match="at least 3, got 2"):
        rm.quantities.peak_pressure("bottom", 1.0, exponent=2)
    assert rm.quantities.peak_pressure("bottom", 1.0, exponent=3)


def test_terms_keep_their_weights_and_names() -> None:
    objective = parse_objective("energy + 0.25*quality + -2*body(x)")
    assert [(weight, term.name) for weight, term in objective.terms] == [
        (1.0, "energy"), (0.25, "quality"), (-2.0, "body(x)")
    ]  # fmt: skip
    assert parse_objective(objective) is objective


def test_the_pressure_of_two_materials_on_a_curved_foundation_is_that_of_the_solution() -> None:
    laws = {"soft": PlaneStrain(10.0, 20.0, body_force=(0.5, -4.0)), "stiff": PlaneStrain(50.0, 90.0)}
    mesh = rm.shapes.rectangle(5, 2, x=(0, 2)).with_subdomains(
        {"soft": lambda x: x[0] < 1.1, "stiff": lambda x: x[0] > 1.1}
    )
    bowl = Obstacle.graph("bottom", lambda x, y: 0.05 * (x - 1) ** 2 - 0.01)
    problem = ContactProblem(mesh, laws, (rm.Dirichlet("top", (0.0, -0.06)),), bowl, Motion(0.01))
    solution = rm.solve(problem, "fixed")
    contact, weights = problem.contact_nodes, nodal_weights(problem, problem.mesh.p)
    assert np.count_nonzero(solution.pressure) >= 3
    expected = float(weights @ (solution.pressure[contact] / 2) ** 4) / 2
    assert value(problem, "peak-pressure(bottom, 2, 4)", solution.displacement) == pytest.approx(
        expected, rel=1e-7
    )
    with pytest.raises(ValueError, match="'top' is not a contact boundary: choose from bottom"):
        value(problem, "peak-pressure(top, 2, 4)")


def test_the_pressure_on_a_disc_is_along_its_normal_at_each_node() -> None:
    """The multipliers of the contact solve are the reference: they know nothing of the elements' pull."""
    disc = Obstacle.circle("bottom", (0.8, -1.0), 1.0)
    top = (rm.Dirichlet("top", (0.02, -0.2)),)
    problem = ContactProblem(
        rm.shapes.rectangle(6, 2, x=(0, 2)), PlaneStrain(30.0, 40.0), top, disc, Motion(0.01)
    )
    solution = rm.solve(problem, "fixed")
    pressed_at = np.flatnonzero(solution.pressure)
    tilt = np.abs(problem.mesh.p[0, pressed_at] - 0.8)
    assert pressed_at.size >= 2
    assert np.max(tilt) > 0.1  # normals that differ
    weights, contact = nodal_weights(problem, problem.mesh.p), problem.contact_nodes
    expected = float(weights @ (solution.pressure[contact] / 5) ** 4) / 2
    assert value(problem, "peak-pressure(bottom, 5, 4)", solution.displacement) == pytest.approx(
        expected, rel=1e-7
    )


def test_an_interface_is_no_boundary_whichever_triangle_it_is_beside() -> None:
    """Also beside the triangle number 0, wherever scikit-fem writes that."""
    mesh = rm.shapes.rectangle(3, 2)
    rng = np.random.default_rng(0)
    places = set()
    for _ in range(20):
        shuffled = type(mesh)(mesh.p, mesh.t[:, rng.permutation(mesh.t.shape[1])])
        inside = np.flatnonzero(np.all(shuffled.f2t >= 0, axis=0) & np.any(shuffled.f2t == 0, axis=0))
        for facet in inside:
            places.add(int(np.flatnonzero(shuffled.f2t[:, facet] == 0)[0]))
            named = shuffled.with_boundaries({"left": lambda x: x[0] == 0, "cut": np.array([facet])})
            problem = ContactProblem(named, rm.Laplace(1.0), ("left",))
            with pytest.raises(ValueError, match="'cut' is an interface inside the body"):
                value(problem, "mean(cut, u)")
    assert places == {0, 1}


@pytest.mark.parametrize("name", ["6.1", "6.2"])
def test_integrals_over_body_and_boundary_are_those_of_scikit_fem(name: str) -> None:
    problem = rm.EXAMPLES[name](4 if name == "6.1" else (6, 3))
    scalar, X = problem.components == 1, problem.mesh.p
    element = ElementTriP1() if scalar else ElementVector(ElementTriP1())
    held, given = problem.held()
    u = np.where(held, given, np.random.default_rng(0).uniform(-1, 1, held.shape))
    body, line = (
        "body(u_x**2 + y*u*u_y)", "boundary(contact, u*sin(y))"
    ) if scalar else (
        "body(ux_y*uy + x*uy_x**2 + 2*ux_x*uy_y)", "boundary(top, -uy*sin(x) + ux*ny)"
    )  # fmt: skip

    def in_body(w: Any) -> Any:
        v, d, (x, y) = np.asarray(w["u"]), w["u"].grad, w.x
        if scalar:
            return d[0] ** 2 + y * v * d[1]
        return d[0, 1] * v[1] + x * d[1, 0] ** 2 + 2 * d[0, 0] * d[1, 1]

    def on_line(w: Any) -> Any:
        v = np.asarray(w["u"])
        return v * np.sin(w.x[1]) if scalar else -v[1] * np.sin(w.x[0]) + v[0] * w.n[1]

    facets = problem.mesh.boundaries["contact" if scalar else "top"]
    for text, form, basis in (
        (body, in_body, Basis(problem.mesh, element, intorder=8)),
        (line, on_line, FacetBasis(problem.mesh, element, facets=facets, intorder=10)),
    ):
        expected = Functional(form).assemble(basis, u=basis.interpolate(u.T.ravel()))
        assert value(problem, text, u) == pytest.approx(expected, rel=1e-8)
    assert X.shape[1] == u.shape[1]


ERRORS = {
    "error-l2": lambda e, de: e**2,
    "error-h1": lambda e, de: de[0] ** 2 + de[1] ** 2,
    "error-energy": lambda e, de: (de[0] ** 2 + de[1] ** 2) / 2,
}


@pytest.mark.parametrize("text", ERRORS)
def test_errors_are_integrals_of_the_distance_to_the_exact_solution(text: str) -> None:
    problem = rm.EXAMPLES["6.1"](4)
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    exact = ca.vertcat(problem.exact.value(x, y))
    both = ca.Function("exact", [x, y], [exact, ca.jacobian(exact, ca.vertcat(x, y)).T])
    u = np.where(problem.held()[0], 0.0, np.random.default_rng(0).uniform(-0.3, 0.3, problem.held()[0].shape))

    def form(w: Any) -> Any:
        shape = w.x[0].shape
        values = both.map(w.x[0].size)(w.x[0].ravel()[None], w.x[1].ravel()[None])
        e, de = values[0].full().reshape(shape), values[1].full().reshape(2, *shape)
        return ERRORS[text](np.asarray(w["u"]) - e, w["u"].grad - de)

    basis = Basis(problem.mesh, ElementTriP1(), intorder=10)
    expected = Functional(form).assemble(basis, u=basis.interpolate(u[0]))
    assert value(problem, text, u) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    "objective", ["mean(top, -uy*exp(x))", "node(4, 1, (uy + 0.05)**2)", "-2*body(ux_x*uy) + 0.1*quality"]
)
def test_gradients_pass_their_taylor_test(objective: str) -> None:
    assert rm.verify_gradient(rm.EXAMPLES["6.2"]((6, 3)), objective).order == pytest.approx(2, abs=0.1)


def test_an_objective_in_python_is_the_same_as_in_text() -> None:
    block = rm.EXAMPLES["6.2"]((6, 3))
    both = rm.quantities.boundary_integral("top", lambda x, y, u, n: -u[1], mean=True)
    both += 0.01 * rm.objective("quality")
    u = np.where(block.held()[0], 0.0, np.random.default_rng(0).uniform(-1, 1, block.mesh.p.shape))
    assert value(block, both, u) == value(block, "mean(top, -uy) + 0.01*quality", u)
    assert str(both) == "boundary integral + 0.01*quality"
    quality = rm.objective("quality")
    with pytest.raises(ValueError, match="must be positive"):
        _ = -quality
    for weight in (float("nan"), float("inf"), 0.0):
        with pytest.raises(ValueError, match="finite and not zero"):
            _ = weight * rm.objective("body(x)")


@pytest.mark.slow
def test_nested_and_mpcc_agree_on_a_quantity() -> None:
    block, objective = rm.EXAMPLES["6.2"]((6, 3)), "peak-pressure(contact, 100) + 0.1*quality"
    nested, mpcc = (rm.solve(block, name, objective=objective) for name in ("nested", "mpcc"))
    values = [solution.record()["objective_value"] for solution in (nested, mpcc)]
    assert values[0] < 0.9 * nested.record()["objective_initial"]
    assert values[0] == pytest.approx(values[1], rel=1e-3)


REFUSED = {
    "mean(tip, uy)": "no boundary 'tip'",
    "body(uz)": "unknown name 'uz'",
    "node(3.9, 1, uy)": "the nearest is node",
    "node(4, 1, u)": "unknown name 'u'",
    "mean(top, __import__('os'))": "mean",
    "error-l2": "needs an exact or reference solution",
    "friction": "needs an exact or reference solution",
    "certificate": "minimised by nested only",
}


@pytest.mark.parametrize("text", REFUSED)
def test_an_objective_that_does_not_suit_a_problem_is_named(text: str) -> None:
    with pytest.raises(ValueError, match=REFUSED[text]):
        value(replace(rm.EXAMPLES["6.2"]((6, 3)), exact=None), text)


def test_the_friction_error_is_refused_where_two_laws_meet() -> None:
    problem = rm.EXAMPLES["6.3"]((4, 2))
    left = np.flatnonzero(problem.mesh.p[0, problem.mesh.t].mean(axis=0) < 2)
    right = np.setdiff1d(np.arange(problem.mesh.t.shape[1]), left)
    mesh = problem.mesh.with_subdomains({"left half": left, "right half": right})
    exact = rm.ExactSolution(lambda x, y: (0 * x, 0 * x), 0.0)
    two = replace(problem, mesh=mesh, law={"left half": problem.law, "right half": problem.law}, exact=exact)
    with pytest.raises(ValueError, match="'friction' needs one law"):
        rm.verify_gradient(two, "friction")
