"""Outer objectives, least squares to measurements among them: values, derivatives, algebra, text."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from skfem import Basis, ElementTriP1, ElementTriP2, ElementVector, FacetBasis, Functional

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.fem.fit import read_measurements
from rmesh_nlp.fem.objective_text import beside, parse_objective
from rmesh_nlp.fem.objectives import TERMS
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.geometry import relocated_mesh
from rmesh_nlp.models.reduced_model import ReducedObjective
from support.designs import block
from support.objectives import value_on
from support.orders import ORDERS
from support.reduced import reduced
from support.solved import example
from support.taylor import difference_order, taylor_order


def value(problem: rm.ContactProblem, text: Any, u: np.ndarray | None = None) -> float:
    """The objective on the given mesh with coefficients u, by default zero, and their slips."""
    found, objective = discretise(problem), parse_objective(text)
    x = np.zeros(found.unknowns.size)
    if u is not None:
        model, free = ContactSolver(found), unknowns(problem, u)
        x[found.n_q : found.n_q + found.n_u] = free
        if found.n_s:
            slips = np.abs(model.slips(problem.mesh.p, free))[found.friction_rows]
            x[-3 * found.n_s : -2 * found.n_s] = slips
    return objective.on(found.fields()).evaluate()(x)


def unknowns(problem: rm.ContactProblem, u: np.ndarray) -> np.ndarray:
    """The displacement unknowns of coefficients, which are as given where they are held."""
    field, n = discretise(problem).displacement, discretise(problem).n_u
    free = np.zeros(n)
    free[field.index[field.index >= 0]] = u[field.index >= 0]
    np.testing.assert_allclose(field.values(free), u, atol=1e-12)
    return free


def drawn(problem: rm.ContactProblem) -> np.ndarray:
    held, given = discretise(problem).space.given()
    return np.where(held, given, np.random.default_rng(0).uniform(-1, 1, held.shape))


@pytest.fixture(scope="module")
def plate() -> rm.ContactProblem:
    """(0, 2) x (0, 1), so that lengths are not 1; nothing is held at the right."""
    mesh = rm.shapes.rectangle(3, 2, x=(0, 2)).with_subdomains({"left half": lambda x: x[0] < 0.5})
    obstacle = rm.Obstacle("bottom", (0.0, 1.0), 0.0)
    return rm.ContactProblem(mesh, rm.PlaneStrain(1.0, 1.0), ("left",), obstacle, rm.Motion(0.01))


def linear(problem: rm.ContactProblem, *slopes: float) -> np.ndarray:
    """Coefficients of the displacement with these multiples of x."""
    return discretise(problem).space.points(np.multiply.outer(slopes, problem.mesh.p[0]))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("body(x**5*y**3)", 2**6 / 6 / 4),  # degree 8: exact
        ("boundary(top, x**8)", 2**9 / 9),
        ("boundary(right, y**8 + 2)", 1 / 9 + 2),
        ("mean(top, x**8)", 2**8 / 9),
        ("body(x) - mean(top, x)+ -0.5*body( y )", 2 - 1 - 0.5),
        ("1e+1*body(x)+2e-1*body(y)+1.E-0*mean(top, x)", 20 + 0.2 + 1),
        ("mean(top, hypot(3*x, 4*x)) + body(1)", 5 + 2),
        ("-body(2*(x + 1e-3) + y*(x-(1)))", -4 - 4e-3),
        ("boundary(bottom, nx - 2*ny)", 4.0),
        ("boundary(left, -nx*y)", 0.5),
    ],
)
def test_integrals_over_a_plate_by_hand(plate: rm.ContactProblem, text: str, expected: float) -> None:
    assert value(plate, text) == pytest.approx(expected, rel=1e-11)


def test_densities_on_a_subdomain_and_functions_of_nodes(plate: rm.ContactProblem) -> None:
    part = rm.quantities.body_integral(lambda x, y, u, slope: x, subdomain="left half")
    basis = Basis(plate.mesh, ElementTriP1(), elements=plate.mesh.subdomains["left half"])
    assert value(plate, part) == pytest.approx(Functional(lambda w: w.x[0]).assemble(basis), rel=1e-12)
    last = plate.mesh.p.shape[1] - 1
    for node in (0, last):
        position = value(plate, rm.quantities.nodal([node], lambda X, u: X[0, 0] + 10 * X[1, 0]))
        assert position == pytest.approx(plate.mesh.p[0, node] + 10 * plate.mesh.p[1, node])
    for nodes in ([], [-1], [last + 1], [0, last + 1]):
        with pytest.raises(ValueError, match=f"between 0 and {last}"):
            value(plate, rm.quantities.nodal(nodes, lambda X, u: X[0, 0]))
    with pytest.raises(ValueError, match=r"one value, got one of shape \(2, 1\)"):
        value(plate, rm.quantities.nodal([0, 1], lambda X, u: X[:, 0]))
    with pytest.raises(ValueError, match="unknown subdomain 'soft': choose from left half"):
        value(plate, rm.quantities.body_integral(lambda *_: 1, subdomain="soft"))
    E = rm.DesignVariable("E", 1.0, (0.5, 2.0))
    with pytest.raises(ValueError, match="depends on the design variables E"):
        value(plate, rm.quantities.body_integral(lambda *_: E.symbol))


def test_a_point_is_a_node_within_a_millionth_of_the_mesh(plate: rm.ContactProblem) -> None:
    u = linear(plate, 0.3, -0.2)
    assert value(plate, "node(2, 1, 10*ux + uy + 100*y)", u) == pytest.approx(6 - 0.4 + 100)
    for off in (0.0, 1.9e-6):
        assert value(plate, f"node({2 - off!r}, 1, x)") == pytest.approx(2)
    with pytest.raises(ValueError, match="no node at"):
        value(plate, f"node({2 - 2.1e-6!r}, 1, x)")


WRONG = {  # the last ones are told by a problem only: Example 6.2 without an exact solution
    "must be positive and finite": ("inf*quality", "nan*quality", "0*body(x)", "-0.5*quality"),
    "'x' in .* is not a number": ("x*quality",),
    "unknown objective 'body": ("body", "body)x(", "body(x"),
    "unknown objective 'error-l3'": ("error-l3 - quality",),
    "unknown objective 'volume": ("volume(x)",),
    r"expected body\(EXPR\)": ("body(x, y)", "body()"),
    r"expected boundary\(NAME, EXPR\)": ("boundary(top)",),
    r"expected mean\(NAME, EXPR\)": ("mean(top, )", "mean(top, x, y)"),
    r"expected node\(X, Y, EXPR\)": ("node(1, x)",),
    "expected peak-pressure": ("peak-pressure(bottom)", "peak-pressure(bottom, 1, 4, 5)"),
    "'a' is not a finite number": ("node(a, 1, x)",),
    r"design\(2 \+\): '2 \+' is not an expression": ("design(2 +)",),
    "is not a finite number": ("node(inf, 1, x)", "peak-pressure(bottom, inf)", "peak-pressure(bottom, nan)"),
    "reference must be positive and finite, got": ("peak-pressure(bottom, 0)", "peak-pressure(bottom, -1)"),
    "whole number, got 4.5": ("peak-pressure(bottom, 1, 4.5)",),
    "at least 3, got 2": ("peak-pressure(bottom, 1, 2)",),
    "unknown name 'u_x'": ("boundary(top, u_x)",),
    "unknown name 'nx'": ("body(nx)", "node(0, 0, nx)"),
    "unknown name 'u": ("body(uz)", "node(4, 1, u)"),
    "unknown boundary 'tip'": ("mean(tip, uy)",),
    "the nearest is node": ("node(3.9, 1, uy)",),
    "mean": ("mean(top, __import__('os'))",),
    "'top' is not a contact boundary: choose from 'contact'": ("peak-pressure(top, 1, 3)", "resultant(top)"),
    r"shear\(contact\): contact on 'contact' is without friction": ("shear(contact)",),
    "reference must be positive and finite, got 0": ("contact-length(contact, 0)",),
    r"expected contact-length\(NAME, P\)": ("contact-length(contact)",),
    r"expected level-pressure\(NAME\)": ("level-pressure()", "level-pressure(a, b)"),
    "unknown objective 'x' in 'area - x'": ("square(area - x)",),
    r"expected square\(SUM - VALUE\)": ("square()",),
    "needs a finite value, got inf": ("square(area - inf)",),
    "must be positive": ("-2*square(area - 1)",),
    "needs an exact or reference solution": ("error-l2", "friction"),
}


@pytest.fixture(scope="module")
def inexact() -> rm.ContactProblem:
    return replace(example("6.2", (6, 3)), exact=None)


@pytest.mark.parametrize(("text", "said"), [(text, said) for said, texts in WRONG.items() for text in texts])
def test_what_is_wrong_with_an_objective_is_said(inexact: rm.ContactProblem, text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        value(inexact, text)


@pytest.mark.parametrize("order", [1, 2])
def test_errors_along_the_contact_by_hand(plate: rm.ContactProblem, order: int) -> None:
    """The exact stresses of (0.5 y, -0.1 y) are 0.5 in shear and -0.3 across; only the bottom is rough."""
    exact = rm.ExactSolution(lambda x, y: ca.vertcat(0.5 * y, -0.1 * y), 0.0)
    walls = rm.Obstacle("bottom", (0.0, 1.0), 0.7, friction=0.6), rm.Obstacle("top", (0.0, -1.0), 0.1)
    problem = replace(plate, obstacle=walls, exact=exact, order=order)
    u = linear(problem, 0.3, -0.2)
    assert value(problem, "contact", u) == pytest.approx(0.3 * (-0.4 + 1.4) + 0.3 * (0.4 + 0.2))
    assert value(problem, "friction", u) == pytest.approx(0.6 * 0.6 - 0.5 * 0.6)


def test_errors_along_the_contact_need_one_law_and_a_boundary() -> None:
    problem = replace(
        example("6.3", (4, 2)), exact=rm.ExactSolution(lambda x, y: ca.vertcat(0 * x, 0 * x), 0.0)
    )
    halves = {"left half": lambda x: x[0] < 2, "right half": lambda x: x[0] > 2}
    two = replace(problem, mesh=problem.mesh.with_subdomains(halves), law=dict.fromkeys(halves, problem.law))
    membrane = replace(example("6.1", 4), obstacle=rm.Obstacle.interior(-1.0))
    for name in ("contact", "friction"):
        assert np.isfinite(value(problem, name))
        with pytest.raises(ValueError, match=f"'{name}' needs one law"):
            value(two, name)
        with pytest.raises(ValueError, match=f"'{name}' needs .* contact .*boundary"):
            value(membrane, name)


FLAGS = {  # is_energy, collapses, has_barrier, needs_exact, the terms in the positions alone
    "energy": (True, True, False, False, ""),
    "2*energy": (True, False, False, False, ""),
    "energy + energy": (False, False, False, False, ""),
    "energy + 0.25*quality": (False, True, True, False, "0.25*quality"),
    "2*energy + quality": (False, False, True, False, "quality"),
    "energy + shape-size + body(x)": (False, False, True, False, "shape-size"),
    "3*elastic": (False, False, True, False, "3*elastic"),
    "-2*body(x)": (False, False, False, False, ""),
    "body(x) + error-l2": (False, False, False, True, ""),
    **{name: (False, False, False, True, "") for name in TERMS if name[:5] in ("error", "conta", "frict")},
}


@pytest.mark.parametrize("text", FLAGS)
def test_what_kind_an_objective_is(text: str) -> None:
    one = parse_objective(text)
    flags = one.is_energy, one.collapses, one.has_barrier, one.needs_exact
    assert (*flags, one.in_positions.text) == FLAGS[text]
    assert str(one) == one.text == text
    assert parse_objective(one) is one


def test_objectives_are_added_and_multiplied_by_finite_numbers() -> None:
    body = parse_objective("body(x)")
    both = -(2 * body) + body * np.int64(3) * 0.5
    assert [(weight, term.name) for weight, term in both.terms] == [(-2.0, "body(x)"), (1.5, "body(x)")]
    for weight in (float("nan"), float("inf"), 0.0):
        with pytest.raises(ValueError, match="finite and not zero"):
            _ = weight * body
    for wrong in (lambda: body + 1, lambda: "2" * body, lambda: body * body):
        with pytest.raises(TypeError):
            wrong()
    for name in set(TERMS) - {"area", "compliance"}:  # nobody wants to maximise these
        with pytest.raises(ValueError, match=f"weight -1 of '{name}' must be positive"):
            _ = -parse_objective(name)


def test_an_interface_is_no_boundary_whichever_triangle_it_is_beside() -> None:
    """Also beside the triangle number 0, wherever scikit-fem writes that."""
    mesh, rng, places = rm.shapes.rectangle(3, 2), np.random.default_rng(0), set()
    for _ in range(5):
        shuffled = type(mesh)(mesh.p, mesh.t[:, rng.permutation(mesh.t.shape[1])])
        inside = np.flatnonzero(np.all(shuffled.f2t >= 0, axis=0) & np.any(shuffled.f2t == 0, axis=0))
        for facet in inside:
            places.add(int(np.flatnonzero(shuffled.f2t[:, facet] == 0)[0]))
            named = shuffled.with_boundaries({"left": lambda x: x[0] == 0, "cut": np.array([facet])})
            with pytest.raises(ValueError, match="'cut' is an interface inside the body"):
                value(rm.ContactProblem(named, rm.Laplace(1.0), ("left",)), "mean(cut, u)")
    assert places == {0, 1}


def exact_error(problem: rm.ContactProblem, w: Any) -> tuple[np.ndarray, np.ndarray]:
    """The error of ``w["u"]`` and its gradient at quadrature points."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    exact = ca.vertcat(problem.exact.value(x, y))
    both = ca.Function("exact", [x, y], [exact, ca.jacobian(exact, ca.vertcat(x, y)).T])
    values = [v.full() for v in both.map(w.x[0].size)(w.x[0].ravel()[None], w.x[1].ravel()[None])]
    return np.asarray(w["u"]) - values[0].reshape(w.x[0].shape), w["u"].grad - values[1].reshape(w.x.shape)


INTEGRALS = {  # by text: the example, the boundary or None, and the form of scikit-fem
    "body(u_x**2 + y*u*u_y)": ("6.1", None, lambda p, w, u, d: d[0] ** 2 + w.x[1] * u * d[1]),
    "boundary(contact, u*sin(y))": ("6.1", "contact", lambda p, w, u, d: u * np.sin(w.x[1])),
    "body(ux_y*uy + x*uy_x**2 + 2*ux_x*uy_y)": (
        "6.2", None, lambda p, w, u, d: d[0, 1] * u[1] + w.x[0] * d[1, 0] ** 2 + 2 * d[0, 0] * d[1, 1]
    ),
    "boundary(top, -uy*sin(x) + ux*ny)": (
        "6.2", "top", lambda p, w, u, d: -u[1] * np.sin(w.x[0]) + u[0] * w.n[1]
    ),
    "error-l2": ("6.1", None, lambda p, w, u, d: exact_error(p, w)[0] ** 2),
    "error-h1": ("6.1", None, lambda p, w, u, d: np.sum(exact_error(p, w)[1] ** 2, axis=0)),
    "error-energy": ("6.1", None, lambda p, w, u, d: np.sum(exact_error(p, w)[1] ** 2, axis=0) / 2),
}  # fmt: skip


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("text", INTEGRALS)
def test_integrals_are_those_of_scikit_fem(text: str, order: int) -> None:
    name, boundary, form = INTEGRALS[text]
    problem = replace(example(name, 4 if name == "6.1" else (6, 3)), order=order)
    element = ElementTriP1() if order == 1 else ElementTriP2()
    element = element if name == "6.1" else ElementVector(element)
    if boundary is None:
        basis = Basis(problem.mesh, element, intorder=10)
    else:
        basis = FacetBasis(problem.mesh, element, facets=problem.mesh.boundaries[boundary], intorder=10)
    u, dofs = drawn(problem), np.hstack([basis.nodal_dofs, *([basis.facet_dofs] if order == 2 else [])])
    values = np.zeros(basis.N)
    values[dofs] = discretise(problem).space.values(u)
    functional = Functional(lambda w: form(problem, w, np.asarray(w["u"]), w["u"].grad))
    expected = functional.assemble(basis, u=basis.interpolate(values))
    assert value(problem, text, u) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("order", ORDERS)
def test_the_gradient_passes_its_taylor_test(order: int) -> None:
    problem = replace(example("6.2", (6, 3)), order=order)
    text = "mean(top, -uy*exp(x)) + 3*node(4, 1, (uy + 0.05)**2) + -200*body(ux_x*uy) + 0.1*quality"
    assert rm.verify_gradient(problem, text).order == pytest.approx(2, abs=0.1)


def still(problem: rm.ContactProblem) -> rm.ContactProblem:
    return replace(problem, motion=rm.Motion(delta=0.05, pinned=tuple(range(problem.mesh.p.shape[1]))))


@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_where_points_are_in_space(order: int) -> None:
    """In triangles whose nodes move, on a boundary along which they slide, and at a corner."""
    problem = replace(example("6.3", (6, 4)), order=order, motion=rm.Motion(delta=0.02))
    points = np.array([[0.9, 2.43, 4.0, 1.0], [0.34, 0.66, 0.0, 1.0]])
    values = np.array([[1e-4, np.nan, -3e-4, 0.0], [-1e-3, -2e-3, np.nan, -1e-3]])
    objective = rm.quantities.fit(points, values, [1, 2, 3, 4])
    energy, rng = reduced(problem), np.random.default_rng(1)
    function = ReducedObjective(energy, objective)
    q, d = rng.uniform(-1, 1, (2, energy.relocation.parts.n_q)) * [[0.3], [1]]
    here = function(q)
    displacement = energy.relocation.displacement.values(energy.unknowns(q, here.equilibrium.u))
    moved = replace(problem, mesh=relocated_mesh(problem.mesh, energy.relocation.nodes(q)))
    assert here.value == pytest.approx(_by_skfem(moved, displacement, points, values), rel=1e-9)
    assert taylor_order(function, q, d) == pytest.approx(2, abs=0.02)
    hessian = function.hessian(here)
    assert difference_order(lambda x: function(x).gradient, hessian(d), q, d) > 1.9


def _by_skfem(problem: rm.ContactProblem, u: np.ndarray, points: np.ndarray, values: np.ndarray) -> float:
    """The weighted squares, the displacement of order 1 or 2 evaluated by barycentric coordinates."""
    basis = Basis(problem.mesh, ElementTriP1() if problem.order == 1 else ElementTriP2())
    nodal = DisplacementSpace(problem).values(u)
    dofs = np.hstack([basis.nodal_dofs, *([basis.facet_dofs] if problem.order == 2 else [])])[0]
    inside = points + 1e-12 * (np.array([[2.0], [0.5]]) - points)
    total = 0.0
    for component, measured in zip(nodal, values, strict=True):
        found = np.zeros(basis.N)
        found[dofs] = component
        there = basis.probes(inside) @ found
        total += float(np.nansum([1, 2, 3, 4] * (there - measured) ** 2))
    return total


FILE = "x, y, ux, uy, weight\n0.9,0.4,1e-4,-1e-3,1\n\n2.2,0.7,,-2e-3,2\n4,0,-3e-4,,3\n"


def test_files_have_empty_cells_and_weights(tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    path.write_text(FILE)
    found = read_measurements(path)
    np.testing.assert_array_equal(found.points, [[0.9, 2.2, 4], [0.4, 0.7, 0]])
    np.testing.assert_array_equal(found.values, [[1e-4, np.nan, -3e-4], [-1e-3, -2e-3, np.nan]])
    np.testing.assert_array_equal(found.weights, [1, 2, 3])
    problem = still(example("6.3", (6, 4)))
    same = rm.quantities.fit(found.points, found.values, found.weights)
    assert value_on(problem, f"2*fit({path}) + area") == pytest.approx(2 * value_on(problem, same) + 4)
    path.write_text("\ufeffy,x,u\n0.25,0.5,0.1\n")  # as spreadsheets write it
    np.testing.assert_array_equal(read_measurements(path).points, [[0.5], [0.25]])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected the columns x, y, u or ux, uy"),
        ("x,y\n0,0\n", "expected the columns"),
        ("x,y,u,u\n0,0,1,1\n", "expected the columns"),
        ("x,y,ux\n0,0,1\n", "expected the columns"),
        ("x,y,ux,uy\n", "nothing is measured"),
        ("x,y,ux,uy\n0,0,,\n", "nothing is measured"),
        ("x,y,ux,uy\n0,0,1\n", "line 2 has 3 cells, expected 4"),
        ("x,y,ux,uy\n\n0,0,1,a\n", "line 3: uy = 'a' is not a number"),
        ("x,y,ux,uy\n,0,1,1\n", "line 2: x = '' is not a number"),
        ("x,y,ux,uy\n0,0,inf,1\n", "must be finite"),
        ("x,y,ux,uy,weight\n0,0,1,1,0\n", "weights must be positive"),
        ("x,y,u\n1,0.5,1\n", "the displacement of .* is ux and uy"),
        ("x,y,ux,uy\n1,2,1,1\n", r"the point \(1, 2\) lies outside of the mesh"),
        ("x,y,ux,uy\n1,0.5,1,1\n", r"the point \(1, 0.5\) may pass into another triangle: pin"),
    ],
)
def test_what_is_wrong_with_measurements_is_said(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=said):
        value(example("6.3", (6, 4)), f"fit({path})")


def test_what_cannot_be_found_is_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"nowhere\.csv: cannot be read: No such file"):
        value(example("6.3", (6, 4)), f"fit({tmp_path / 'nowhere.csv'})")
    with pytest.raises(ValueError, match=r"expected fit\(FILE\)"):
        parse_objective("fit()")
    with pytest.raises(ValueError, match="expected points"):
        rm.quantities.fit([0.0, 1.0], [1.0])
    free = replace(example("6.3", (6, 4)), motion=rm.Motion(delta=None))
    with pytest.raises(ValueError, match="may pass into another triangle"):
        value(free, rm.quantities.fit([[0.9], [0.4]], [[0.0], [0.0]]))


def test_files_are_beside_the_file_that_names_them() -> None:
    folder = Path("/a/b")
    assert beside("2*fit( m.csv ) + square(fit(c/m.csv) - 1)", folder) == (
        "2*fit(/a/b/m.csv) + square(fit(/a/b/c/m.csv) - 1)"
    )
    assert beside("fit(/m.csv) + mean(fit, -uy)", folder) == "fit(/m.csv) + mean(fit, -uy)"


@pytest.mark.slow
def test_moduli_and_friction_are_identified() -> None:
    """From the displacement at the lower edge of the same block with other numbers."""
    E, F = rm.DesignVariable("E", 1.0, (0.5, 2.0)), rm.DesignVariable("F", 0.05, (0.0, 0.3))
    problem = replace(block(E, F, n=(4, 2)), motion=rm.Motion(delta=0.0))
    true = rm.solve(problem.at_design({"E": 1.4, "F": 0.2}), "fixed")
    nodes = np.flatnonzero(problem.mesh.p[1] == 0)
    objective = 1e6 * rm.quantities.fit(problem.mesh.p[:, nodes], true.displacement[:, nodes])
    found = rm.solve(problem, "nested", objective=objective)
    assert found.success
    assert found.record()["iterations"] < 100
    assert found.design["E"] == pytest.approx(1.4, rel=1e-4)
    assert found.design["F"] == pytest.approx(0.2, rel=1e-3)


def test_the_gain_is_measured_on_refined_meshes_whose_triangles_a_point_could_leave() -> None:
    problem = replace(example("6.3", (4, 2)), motion=rm.Motion(delta=0.02))
    objective = 1e6 * rm.quantities.fit([[0.51], [0.4]], [[np.nan], [-2e-3]])
    with pytest.raises(ValueError, match="may pass into another triangle"):
        value_on(rm.refined(problem), objective)
    solution = rm.solve(problem, "nested", objective=objective)
    assert solution.success
    assert np.isfinite(solution.record()["gain_surviving"])
