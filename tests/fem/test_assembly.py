"""Fields, sums over elements, values at points, and derivatives of assembled programs."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import factorial
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import Assembled
from rmesh_nlp.fem.cells import Straight
from rmesh_nlp.fem.energy import load_energy, strain_energy
from rmesh_nlp.fem.fields import (
    NONE,
    ElementGroup,
    Field,
    unknown_field,
)
from rmesh_nlp.models.energy_nlp import Relocation, relocation
from rmesh_nlp.problem import ContactProblem, Laplace, PlaneStrain
from rmesh_nlp.problem.quadrature import triangle_rule
from rmesh_nlp.vectorised import NUMPY_FROM
from support.contact_geometry import block_along_a_circle
from support.derivatives import assert_derivatives_are_casadis
from support.problems import sloped_block, tied_neighbours


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


def of_energy_nlp(rel: Relocation) -> tuple[ca.MX, ca.MX]:
    valid = rel.validity.group.shifted(rel.parts.n_contact + 2 * rel.parts.n_s)
    return expressions([*rel.groups, valid], rel.x, rel.n_rows)


def wave(x, y):
    return ca.sin(2 * x + y) + ca.if_else(x < y, x * y, y**3)


LAWS = {
    "varying": Laplace(wave, conductivity=2.5),
    "two components": PlaneStrain(1.3, 0.7, (wave, lambda x, y: ca.exp(x - y))),
}


@pytest.mark.parametrize(
    "make",
    [
        lambda: replace(EXAMPLES["6.1"](2, 0.1), quadrature=4),
        lambda: EXAMPLES["6.3"]((4, 2)),
        lambda: sloped_block(n=(4, 2)),
        lambda: block_along_a_circle(2),
        tied_neighbours,
        lambda: replace(EXAMPLES["6.1"](2, 0.1), law=LAWS["varying"], order=2),
    ],
)
def test_derivatives_are_those_of_automatic_differentiation(make: Callable[[], ContactProblem]) -> None:
    rel = relocation(make())
    f, g = of_energy_nlp(rel)
    derivatives = rel.nlp.derivatives
    program = SimpleNamespace(x=rel.x, p=rel.nlp.p, f=f, g=g, derivatives=derivatives)
    assert_derivatives_are_casadis(program, within=(-0.5, 0.5))
    x = np.random.default_rng(0).uniform(-0.5, 0.5, rel.n_x)
    value, rows = ca.Function("values", [rel.x], [rel.nlp.f, rel.nlp.g])(x)
    assert float(value) == pytest.approx(float(derivatives.grad_f(x, [])[0]), rel=1e-12)
    np.testing.assert_allclose(rows.full(), derivatives.jac_g(x, [])[0].full(), rtol=1e-12, atol=1e-12)


def test_an_extended_program_keeps_the_assembled_derivatives() -> None:
    rel, y = relocation(EXAMPLES["6.3"]((4, 2))), ca.MX.sym("y", 2)
    f, g = ca.sumsqr(y - rel.x[:2]), ca.sin(y[0]) * rel.x[5]
    wider = rel.nlp.extended(x=y, f=f, g=g, lbx=[0, 0], ubx=[1, 1], lbg=[0], ubg=[1])
    first, rows = of_energy_nlp(rel)
    program = SimpleNamespace(
        x=wider.x, p=wider.p, f=first + f, g=ca.vertcat(rows, g), derivatives=wider.derivatives
    )
    assert_derivatives_are_casadis(program, within=(-0.5, 0.5), tolerance=1e-10)


def test_nothing_is_unrolled_over_the_mesh() -> None:
    # the expression graph of the assembled functions must not grow with the mesh
    def nodes(n: int) -> int:
        derivatives = relocation(EXAMPLES["6.1"](n)).nlp.derivatives
        assert derivatives is not None
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
    problem, gradients = EXAMPLES["6.1"](n=3), []
    for load in (lambda x, y: x, lambda x, y: x + y):
        program = relocation(replace(problem, law=replace(problem.law, source=load)))
        gradients.append(program.assembled.first(np.linspace(0, 1, program.nlp.n_x), None)[1])
    assert np.max(np.abs(gradients[0] - gradients[1])) > 1e-3


def drawn_triangles(n: int) -> np.ndarray:
    """Corners of upright triangles (6, n) that are not too thin."""
    rng = np.random.default_rng(3)
    a, length, angle = rng.uniform(-1, 1, (2, n)), rng.uniform(0.2, 2, (2, n)), rng.uniform(0.2, 2.8, n)
    turn = rng.uniform(0, 2 * np.pi, n)
    b = a + length[0] * np.stack([np.cos(turn), np.sin(turn)])
    c = a + length[1] * np.stack([np.cos(turn + angle), np.sin(turn + angle)])
    return np.concatenate([a, b, c])


def test_many_triangles_are_summed_as_few_are() -> None:
    law, n = LAWS["two components"], 2 * NUMPY_FROM + 5  # more than one chunk of points
    X, u = drawn_triangles(n), np.random.default_rng(0).standard_normal((6, n))
    cell = Straight(3, 2, 1)
    functions = (strain_energy(law, cell), None), load_energy(law, cell, 8)

    def gradient(X: np.ndarray, u: np.ndarray) -> np.ndarray:
        """By positions and by displacements (12, count), which no two elements share."""
        fields = unknown_field(X.shape), unknown_field(X.shape, X.size)
        rows = np.zeros((0, X.shape[1]), dtype=np.int64)
        groups = [ElementGroup(function, fields, rows, points) for function, points in functions]
        assembled = Assembled(groups, ca.MX.sym("x", 2 * X.size), ca.MX(0, 1), 0)
        x = np.concatenate([X.ravel(order="F"), u.ravel(order="F")])
        return assembled.first(x, None)[1].reshape(2, -1, 6)

    together = gradient(X, u)
    for k in range(0, n, 7):
        alone = gradient(X[:, [k]], u[:, [k]])[:, 0]
        np.testing.assert_allclose(together[:, k], alone, rtol=0, atol=1e-11 * np.max(np.abs(alone)))
