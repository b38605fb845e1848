"""Fields and sums over elements, and derivatives of assembled programs by automatic differentiation."""

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
from rmesh_nlp.fem.fields import CONSTANT, STRAIGHT, Bends, Field, constant_field
from rmesh_nlp.fem.functional import scaled_group
from rmesh_nlp.fem.sums import Entries, Sums
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


NODES = np.array([[0, 2, 1], [3, 1, 0]])


def field() -> Field:
    """Two components at four nodes, one value of which is fixed and one on a curve."""
    index = np.array([[0, 2, CONSTANT, 4], [1, 3, 5, 6]])
    t, which = ca.SX.sym("t"), np.full((2, 4), STRAIGHT)
    which[1, 3] = 0
    bends = Bends(which, (ca.Function("square", [t], [t**2]),))
    return Field(index, np.arange(1.0, 9.0).reshape(2, 4), np.linspace(0, 1, 8).reshape(2, 4), bends=bends)


def columns(values: np.ndarray) -> np.ndarray:
    """Node by node, each with its components."""
    return np.array([np.concatenate([values[:, node] for node in nodes]) for nodes in NODES.T]).T


def test_local_values_are_those_of_the_nodes() -> None:
    nodal = field()
    local, w = nodal.at(NODES), np.random.default_rng(0).standard_normal(7)
    assert local.shape == (4, 3) == local.index.shape
    for name in ("index", "scale", "offset"):
        np.testing.assert_array_equal(getattr(local, name), columns(getattr(nodal, name)))
    np.testing.assert_array_equal(local.values(w), columns(nodal.values(w)))
    np.testing.assert_array_equal(local.elements(np.array([2, 0])).values(w), local.values(w)[:, [2, 0]])


def test_a_straight_field_is_the_affine_one() -> None:
    local, w = field().at(NODES), np.full(7, 2.0)
    assert local.bends is not None
    np.testing.assert_array_equal(local.bends.which, columns(field().bends.which))
    straight = local.straight()
    assert straight.bends is None
    affine = np.where(local.index == CONSTANT, 0.0, 2.0 * local.scale) + local.offset
    np.testing.assert_allclose(straight.values(w), affine, rtol=1e-15)
    assert np.any(straight.values(w) != local.values(w))


def test_a_constant_field_has_no_unknowns() -> None:
    values = np.arange(6.0).reshape(2, 3)
    constant = constant_field(values)
    assert constant.shape == (2, 3)
    assert np.all(constant.index == CONSTANT)
    np.testing.assert_array_equal(constant.values(np.ones(4)), values)


def entries(seed: int, shape: tuple[int, int], local: tuple[int, int], *, scaled: bool) -> Entries:
    """Places, some of them taken twice and some dropped."""
    rng = np.random.default_rng(seed)
    row, column = (rng.integers(-1, n, local) for n in shape)
    return Entries(row, column, rng.standard_normal(local) if scaled else None)


@pytest.mark.parametrize("shape", [(5, 7), (6, 1), (1, 1)])
@pytest.mark.parametrize("scaled", [False, True])
def test_nonzeros_are_the_sums_of_their_results(shape, scaled) -> None:
    parts = [entries(1, shape, (3, 20), scaled=scaled), entries(2, shape, (2, 9), scaled=False)]
    sums, results = Sums(shape, parts), np.random.default_rng(3).standard_normal(78)
    expected, filled = np.zeros(shape), np.zeros(shape, dtype=bool)
    flat = [np.concatenate([np.ravel(getattr(part, axis)) for part in parts]) for axis in ("row", "column")]
    scale = np.concatenate([np.ones(p.row.size) if p.scale is None else p.scale.ravel() for p in parts])
    for i, j, factor, result in zip(*flat, scale, results, strict=True):
        if i >= 0 and j >= 0:
            expected[i, j] += factor * result
            filled[i, j] = True
    matrix = sums.numbered.astype(float)
    np.testing.assert_array_equal(matrix.data, 1 + np.arange(sums.n))
    matrix.data = sums(results)
    np.testing.assert_allclose(matrix.toarray(), expected, rtol=1e-12, atol=1e-14)
    assert sums.n_local == 78
    assert sums.pattern.nnz() == sums.n == (filled.sum() if shape[1] > 1 else shape[0])
    np.testing.assert_array_equal(sums.pattern.row(), matrix.indices)


def test_results_by_element_go_to_the_same_places() -> None:
    shape = (5, 7)
    parts = [entries(1, shape, (3, 20), scaled=True), entries(2, shape, (2, 9), scaled=True)]
    sums, rng = Sums(shape, parts), np.random.default_rng(3)
    local = [rng.standard_normal(part.row.shape) for part in parts]
    found = sums(np.concatenate([one.ravel() for one in local]))
    by_element = sum(
        sums.by_element(number, one.shape).full() @ one.ravel(order="F") for number, one in enumerate(local)
    )
    np.testing.assert_allclose(by_element, found, rtol=1e-12, atol=1e-14)


def test_sums_of_nothing_have_no_nonzeros() -> None:
    sums = Sums((4, 3), [])
    assert (sums.n, sums.n_local, sums(np.zeros(0)).size) == (0, 0, 0)
    np.testing.assert_array_equal(Sums((4, 1), [])(np.zeros(0)), np.zeros(4))
