from collections.abc import Callable
from dataclasses import replace
from math import factorial

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import element_values
from rmesh_nlp.fem.distortion import distortion_group
from rmesh_nlp.fem.element import differentiated
from rmesh_nlp.fem.energy import strain_energy, triangle_rule
from rmesh_nlp.fem.functional import scaled_group
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.optimize.nlp import NLP
from rmesh_nlp.problem import ContactProblem, PlaneStrain
from support.contact_geometry import block_along_a_circle
from support.problems import sloped_block, tied_neighbours


def automatic(nlp: NLP, x: np.ndarray, lam_g: np.ndarray) -> list[np.ndarray]:
    """Gradient, Jacobian and Hessian by CasADi from the same expressions."""
    lam = ca.MX.sym("lam", nlp.n_g)
    lagrangian = nlp.f * 0.7 + ca.dot(lam, nlp.g)
    function = ca.Function(
        "ad",
        [nlp.x, lam],
        [ca.gradient(nlp.f, nlp.x), ca.jacobian(nlp.g, nlp.x), ca.triu(ca.hessian(lagrangian, nlp.x)[0])],
    )
    return [value.full() for value in function(x, lam_g)]


def check(nlp: NLP, tolerance: float = 1e-12) -> None:
    rng = np.random.default_rng(1)
    x, lam_g = 0.5 * rng.uniform(-1, 1, nlp.n_x), rng.standard_normal(nlp.n_g)
    ours = nlp.derivatives
    assert ours is not None
    (f, gradient), (g, jacobian) = ours.grad_f(x, []), ours.jac_g(x, [])
    value, rows = ca.Function("values", [nlp.x], [nlp.f, nlp.g])(x)
    found = [f, g, gradient, jacobian, ours.hess_lag(x, [], 0.7, lam_g)]
    for one, other in zip(found, [value.full(), rows.full(), *automatic(nlp, x, lam_g)], strict=True):
        np.testing.assert_allclose(one.full(), other, atol=tolerance * max(1, np.abs(other).max(initial=0)))


@pytest.mark.parametrize(
    "make",
    [
        lambda: replace(EXAMPLES["6.1"](4, 0.1), quadrature=4),
        lambda: EXAMPLES["6.3"]((4, 2)),
        sloped_block,
        lambda: block_along_a_circle(2),
        tied_neighbours,
    ],
)
def test_derivatives_are_those_of_automatic_differentiation(make: Callable[[], ContactProblem]) -> None:
    check(relocation(make()).nlp)


def test_an_extended_program_keeps_the_assembled_derivatives() -> None:
    nlp = relocation(EXAMPLES["6.3"]((4, 2))).nlp
    y = ca.MX.sym("y", 2)
    wider = nlp.extended(
        x=y, f=ca.sumsqr(y - nlp.x[:2]), g=ca.sin(y[0]) * nlp.x[5], lbx=[0, 0], ubx=[1, 1], lbg=[0], ubg=[1]
    )
    check(wider, 1e-10)


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


def test_equal_functions_share_their_derivatives_and_others_do_not() -> None:
    laws = PlaneStrain(1.0, 2.0), PlaneStrain(1.0, 2.0), PlaneStrain(1.0, 3.0)
    one, same, other = (differentiated(strain_energy(law), None, [0, 1]) for law in laws)
    assert one is same
    assert one is not other
    assert differentiated(strain_energy(laws[0]), None, [1]) is not one
    problem, gradients = EXAMPLES["6.1"](n=3), []
    for load in (lambda x, y: x, lambda x, y: x + y):  # problems that differ in their load alone
        program = relocation(replace(problem, law=replace(problem.law, source=load)))
        gradients.append(program.assembled.grad_f(np.linspace(0, 1, program.nlp.n_x), [])[1].full())
    assert np.max(np.abs(gradients[0] - gradients[1])) > 1e-3


def test_weights_of_a_group_share_one_differentiated_function() -> None:
    problem = EXAMPLES["6.1"](n=2)
    group = distortion_group(problem, MeshMap.of(problem).positions, "quality")
    one, two = (scaled_group(group, weight) for weight in (0.5, 3.0))
    assert one.function.serialize() == two.function.serialize()
    q = 0.1 * np.ones(MeshMap.of(problem).n)
    plain, *weighted = (
        element_values([each])(q)[0].sum() for each in (group, one, two, scaled_group(one, 2.0))
    )
    assert weighted == pytest.approx([0.5 * plain, 3 * plain, plain], rel=1e-14)


def test_functions_for_few_elements_have_the_same_values() -> None:
    found = differentiated(strain_energy(PlaneStrain(1.0, 1.0)), None, [0, 1])
    X, u = np.array([0, 0, 1, 0, 0.2, 1]), np.array([0.1, 0, 0.3, -0.2, 0, 0.4])
    for which in ("gradient", "hessian"):
        more = (1.0, np.zeros((0, 1))) if which == "hessian" else ()
        many, few = (found.function(which, for_few=one)(X, u, *more) for one in (False, True))
        for a, b in zip(*(part if isinstance(part, tuple) else (part,) for part in (many, few)), strict=True):
            np.testing.assert_allclose(a.full(), b.full(), rtol=1e-13, atol=1e-14)
