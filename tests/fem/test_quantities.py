"""Outer objectives of one's own: values against scikit-fem, gradients by their Taylor test, refusals."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from skfem import Basis, ElementTriP1, ElementVector, FacetBasis, Functional

import rmesh_nlp as rm
from rmesh_nlp.fem.contact_terms import nodal_weights
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.problem import Motion
from rmesh_nlp.solving.outer import Outer


@pytest.fixture(scope="module")
def block() -> rm.ContactProblem:
    return rm.EXAMPLES["6.2"]((6, 3))


@pytest.fixture(scope="module")
def outer(block: rm.ContactProblem) -> Outer:
    """What every strategy hands an objective to."""
    return Outer(block)


@pytest.fixture(scope="module")
def membrane() -> rm.ContactProblem:
    return rm.EXAMPLES["6.1"](4)


def value(problem: rm.ContactProblem, objective: Any) -> tuple[rm.Solution, float]:
    solution = rm.solve(problem, "fixed", objective=objective)
    return solution, solution.extra["objective_value"]


def by_skfem(solution: rm.Solution, integrand: Callable[..., Any], boundary: str | None = None) -> float:
    """The integral of ``integrand(x, u, grad u, n)`` by scikit-fem."""
    scalar = solution.displacement.shape[0] == 1
    element = ElementTriP1() if scalar else ElementVector(ElementTriP1())
    mesh = solution.mesh
    basis: Any = Basis(mesh, element, intorder=8)
    if boundary is not None:
        basis = FacetBasis(mesh, element, facets=mesh.boundaries[boundary], intorder=8)
    u = solution.displacement.T.ravel()
    form = Functional(lambda w: integrand(w.x, np.asarray(w["u"]), w["u"].grad, getattr(w, "n", None)))
    return float(form.assemble(basis, u=basis.interpolate(u)))


def test_integrals_over_a_boundary_are_those_of_scikit_fem(block: rm.ContactProblem) -> None:
    solution, ours = value(block, "boundary(top, -uy*sin(x) + ux*ny)")
    theirs = by_skfem(solution, lambda x, u, du, n: -u[1] * np.sin(x[0]) + u[0] * n[1], "top")
    assert ours == pytest.approx(theirs, rel=1e-8)


@pytest.mark.parametrize("boundary", ["left", "right", "top", "contact"])
def test_normals_point_out_of_the_body(block: rm.ContactProblem, boundary: str) -> None:
    _, ours = value(block, f"mean({boundary}, nx + 10*ny)")
    expected = {"left": -1, "right": 1, "top": 10, "contact": -10}[boundary]
    assert ours == pytest.approx(expected, abs=1e-12)


def test_integrals_over_the_body_are_those_of_scikit_fem(
    block: rm.ContactProblem, membrane: rm.ContactProblem
) -> None:
    solution, ours = value(block, "body(ux_y*uy + x*uy_x**2 + 2*ux_x*uy_y)")
    theirs = by_skfem(
        solution, lambda x, u, du, n: du[0, 1] * u[1] + x[0] * du[1, 0] ** 2 + 2 * du[0, 0] * du[1, 1]
    )
    assert ours == pytest.approx(theirs, rel=1e-10)
    solution, ours = value(membrane, "body(u_x**2 + y*u*u_y)")
    theirs = by_skfem(solution, lambda x, u, du, n: du[0] ** 2 + x[1] * u * du[1])
    assert ours == pytest.approx(theirs, rel=1e-10)


def test_the_value_at_a_node_is_its_displacement(block: rm.ContactProblem) -> None:
    solution, ours = value(block, "node(4, 1, 3*uy)")
    (corner,) = np.flatnonzero((block.mesh.p[0] == 4) & (block.mesh.p[1] == 1))
    assert ours == pytest.approx(3 * solution.displacement[1, corner], rel=1e-12)


@pytest.mark.parametrize("name", ["6.1", "6.2", "6.3"])
def test_the_smoothed_peak_is_a_power_mean_of_the_nodal_pressure(name: str) -> None:
    problem = rm.EXAMPLES[name](4 if name == "6.1" else (6, 3))
    solution, ours = value(problem, "peak-pressure(contact, 10, 12)")
    nodes = problem.contact_nodes
    weights = nodal_weights(problem, problem.mesh.p)
    edges = problem.mesh.facets[:, problem.mesh.boundaries["contact"]]
    length = np.linalg.norm(np.diff(problem.mesh.p[:, edges], axis=1), axis=(0, 1)).sum()
    expected = float(weights @ (solution.pressure[nodes] / 10) ** 12) / length
    assert ours == pytest.approx(expected, rel=1e-6)
    assert 10 * ours ** (1 / 12) < solution.pressure.max()


OBJECTIVES = [
    "mean(top, -uy*exp(x))",
    "node(4, 1, (uy + 0.05)**2)",
    "peak-pressure(contact, 100)",
    "-2*body(ux_x*uy) + 0.1*quality",
]


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_gradients_pass_their_taylor_test(block: rm.ContactProblem, objective: str) -> None:
    assert rm.verify_gradient(block, objective).order == pytest.approx(2, abs=0.1)


def test_an_objective_in_python_is_the_same_as_in_text(block: rm.ContactProblem) -> None:
    sag = rm.quantities.boundary_integral("top", lambda x, y, u, n: -u[1], mean=True)
    both = sag + 0.01 * rm.objective("quality")
    assert value(block, both)[1] == value(block, "mean(top, -uy) + 0.01*quality")[1]
    assert rm.verify_gradient(block, both)
    assert str(both) == "boundary integral + 0.01*quality"


@pytest.mark.slow
def test_nested_and_mpcc_agree_on_a_quantity(block: rm.ContactProblem) -> None:
    objective = "peak-pressure(contact, 100) + 0.1*quality"
    nested, mpcc = (rm.solve(block, name, objective=objective) for name in ("nested", "mpcc"))
    assert nested.extra["objective_value"] < 0.9 * nested.extra["objective_initial"]
    assert nested.extra["objective_value"] == pytest.approx(mpcc.extra["objective_value"], rel=1e-3)
    assert nested.record()["objective"] == objective


def test_a_quantity_of_several_nodes(membrane: rm.ContactProblem) -> None:
    spread = rm.quantities.nodal([6, 8], lambda X, u: (u[0, 0] - u[0, 1]) ** 2 + X[0, 0])
    solution, ours = value(membrane, spread)
    u = solution.displacement[0]
    assert ours == pytest.approx((u[6] - u[8]) ** 2 + membrane.mesh.p[0, 6])
    assert rm.verify_gradient(membrane, spread)


def test_a_density_on_a_subdomain_counts_there_alone() -> None:
    mesh = rm.shapes.rectangle(4, 4).with_subdomains({"lower": lambda x: x[1] < 0.5})
    problem = rm.ContactProblem(mesh, rm.Laplace(1.0), ("left",), motion=Motion(0.02))
    area = rm.quantities.body_integral(lambda x, y, u, slope: 1, subdomain="lower")
    assert value(problem, area)[1] == pytest.approx(0.5)


REFUSED = {
    "mean(tip, uy)": "no boundary 'tip'",
    "body(uz)": "unknown name 'uz'",
    "node(1, 2)": r"expected node\(X, Y, EXPR\)",
    "node(3.9, 1, uy)": "the nearest is node",
    "node(4, 1, u)": "unknown name 'u'",
    "peak-pressure(contact, -1)": "must be positive, got -1",
    "peak-pressure(top, 1)": "'top' is not a contact boundary: choose from contact",
    "peak-pressure(contact, 1, 2)": "at least 3",
    "peak-pressure(contact, 1, 3.5)": "whole number",
    "boundary(top, ux_x)": "unknown name 'ux_x'",
    "mean(top, __import__('os'))": "mean",
    "0*mean(top, uy)": "weight '0'",
    "mean(top, uy": "unknown objective",
    "-1*quality": "must be positive",
}


@pytest.mark.parametrize("text", REFUSED)
def test_what_is_wrong_is_said(outer: Outer, text: str) -> None:
    with pytest.raises(ValueError, match=REFUSED[text]):
        _ = outer.minimising(parse_objective(text)).function


def test_objects_refuse_weights_of_no_sense() -> None:
    quality = rm.objective("quality")
    with pytest.raises(ValueError, match="must be positive"):
        _ = -quality
    with pytest.raises(ValueError, match="finite and not zero"):
        _ = float("nan") * quality
