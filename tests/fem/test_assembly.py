"""Sums over elements and their derivatives, exact rules, loads that jump or kink within elements."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import factorial
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.energy import load_vector
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.fem.contact_terms import friction, gaps
from rmesh_nlp.fem.fields import NONE, ElementGroup, Field
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.problem.body import Body
from rmesh_nlp.problem.quadrature import triangle_rule
from support.contact_geometry import block_along_a_circle
from support.derivatives import assert_derivatives_are_casadis
from support.problems import sloped_block, tied_neighbours
from support.taylor import difference_order, taylor_order


def expressions(groups: Sequence[ElementGroup], x: ca.MX, n_rows: int) -> tuple[ca.MX, ca.MX]:
    """Objective and rows element by element, as CasADi expressions of the unknowns."""
    f, g = ca.MX(0), ca.MX.zeros(n_rows)
    for group in groups:
        for element in range(group.size):
            fields = (field.elements([element]) for field in group.arguments)
            value, rows = group.plain(*(local(field, x) for field in fields))
            f += value
            for k, row in enumerate(group.rows[:, element].tolist()):
                g[row] += rows[k]
    return f, g


def local(field: Field, x: ca.MX) -> ca.MX:
    parts = zip(field.index.flat, field.scale.flat, field.offset.flat, strict=True)
    return ca.vertcat(*(o + s * x[int(i)] if i != NONE else o for i, s, o in parts))


def wave(x, y):
    return ca.sin(2 * x + y) + ca.if_else(x < y, x * y, y**3)


def test_meshes_of_a_problem_share_functions_of_contact() -> None:
    problem = replace(sloped_block(), order=2)
    coarse, fine = (discretise(each).fields() for each in (problem, rm.refined(problem)))
    for groups in (gaps, friction):
        assert {id(one.function) for one in groups(coarse)} == {id(one.function) for one in groups(fine)}


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        lambda: replace(rm.EXAMPLES["6.1"](2, 0.1), quadrature=4),
        lambda: rm.EXAMPLES["6.3"]((4, 2)),
        lambda: sloped_block(n=(4, 2)),
        lambda: block_along_a_circle(2),
        tied_neighbours,
        lambda: replace(rm.EXAMPLES["6.1"](2, 0.1), law=rm.Laplace(wave, conductivity=2.5), order=2),
    ],
)
def test_derivatives_are_those_of_automatic_differentiation(make: Callable[[], rm.ContactProblem]) -> None:
    rel = relocation(make())
    valid = rel.validity.group.shifted(rel.rows["valid"].start)
    f, g = expressions([*rel.groups, valid], rel.x, rel.rows.size)
    derivatives = rel.nlp.derivatives
    program = SimpleNamespace(x=rel.x, p=rel.nlp.p, f=f, g=g, derivatives=derivatives)
    assert_derivatives_are_casadis(program, within=(-0.5, 0.5))
    x = np.random.default_rng(0).uniform(-0.5, 0.5, rel.unknowns.size)
    value, rows = ca.Function("values", [rel.x], [rel.nlp.f, rel.nlp.g])(x)
    assert float(value) == pytest.approx(float(derivatives.grad_f(x, [])[0]), rel=1e-12)
    np.testing.assert_allclose(rows.full(), derivatives.jac_g(x, [])[0].full(), rtol=1e-12, atol=1e-12)


def test_nothing_is_unrolled_over_the_mesh() -> None:
    # the expression graph of the assembled functions must not grow with the mesh
    def nodes(n: int) -> int:
        derivatives = relocation(rm.EXAMPLES["6.1"](n)).nlp.derivatives
        return sum(f.n_instructions() for f in (derivatives.grad_f, derivatives.jac_g, derivatives.hess_lag))

    assert nodes(4) == nodes(8)


def test_quadrature_rules_integrate_their_degree_exactly() -> None:
    for quadrature, degree in [("midpoint", 2), (3, 3), (10, 10), (19, 19), (20, 20), (25, 25)]:
        points, weights = triangle_rule(quadrature)
        for a in range(degree + 1):
            for b in range(degree + 1 - a):
                c = degree - a - b
                exact = 2 * factorial(a) * factorial(b) * factorial(c) / factorial(degree + 2)
                value = weights @ (points[0] ** a * points[1] ** b * points[2] ** c)
                assert abs(value - exact) < 1e-12 * max(exact, 1e-3), (quadrature, a, b, c)


def test_problems_that_differ_in_their_load_alone_share_no_derivatives() -> None:
    problem, gradients = rm.EXAMPLES["6.1"](n=3), []
    for load in (lambda x, y: x, lambda x, y: x + y):
        program = relocation(replace(problem, law=replace(problem.law, source=load)))
        gradients.append(program.assembled.first(np.linspace(0, 1, program.nlp.n_x), None)[1])
    assert np.max(np.abs(gradients[0] - gradients[1])) > 1e-3


JUMPS = (
    lambda x, y: rm.where(x > 1.51787, -5.62, -1.3534646),
    lambda x, y: rm.where(ca.logic_and(x > 0.3, x < 0.35), -7.0, ca.fabs(x - 0.9)),
)
SOURCES = (lambda x, y: rm.where(x + 0.7 * y > 1.1, -3.5, 2.0 * y), lambda x, y: ca.fmax(y - 0.6 * x, 0.0))


def pulled(order: int) -> rm.ContactProblem:
    return rm.ContactProblem(
        rm.shapes.rectangle(3, 2, x=(0, 2)),
        rm.PlaneStrain.from_young(1000.0, 0.3, SOURCES),
        ("left",),
        rm.Obstacle.line("bottom", (0.0, -0.01), (0.0, 1.0), lambda x, y: rm.where(x < 1.51787, 3.0, 0.5)),
        rm.Motion(None),
        (rm.Traction("top", JUMPS),),
        order=order,
    )


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_nodal_loads_are_exact_wherever_the_nodes_are(order: int) -> None:
    problem = pulled(order)
    mesh, rng = problem.mesh, np.random.default_rng(1)
    p = np.array(mesh.p)
    for k, end in enumerate((2, 1)):
        inner = (p[k] > 0) & (p[k] < end)
        p[k, inner] += rng.uniform(-0.1, 0.1, np.count_nonzero(inner))
    moved = replace(problem, mesh=replace(mesh, doflocs=p))
    space = DisplacementSpace(moved)
    exact, doubt = load_vector(Body(moved, p), space)
    held = space.given()[0].T.ravel()
    system = ContactSolver(moved).system(p)
    assert np.max(doubt) < 1e-12
    np.testing.assert_allclose(np.sort(system.load), np.sort(exact[~held]), atol=1e-11)
    # shape functions times x at the nodes add up to x; that of the held node has none
    moment = (3.0 * 1.51787**2 + 0.5 * (2**2 - 1.51787**2)) / 2
    x = space.points(p)[0, space.contact_nodes]
    assert system.slip_bound @ x == pytest.approx(moment, rel=1e-12)


@pytest.mark.slow
def test_the_energy_of_loads_that_jump_has_both_derivatives() -> None:
    outer = rm.Outer.of(pulled(1))
    q, d = np.random.default_rng(1).uniform(-1, 1, (2, outer.n)) * [[0.1], [1]]
    assert taylor_order(outer.energy, q, d, 1e-4) == pytest.approx(2, abs=0.02)
    product = outer.energy.hessian(outer.energy(q))(d)
    order_of = difference_order(lambda at: outer.energy(at).gradient, product, q, d, 1e-3)
    assert order_of == pytest.approx(2, abs=0.05)
