"""Fields, sums over elements, values at points, and derivatives of assembled programs."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import factorial
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import Assembled, Entries, Part, Sums
from rmesh_nlp.fem.cells import Straight
from rmesh_nlp.fem.element import PointSums
from rmesh_nlp.fem.energy import load_energy, strain_energy
from rmesh_nlp.fem.fields import (
    NONE,
    Bends,
    ElementGroup,
    Field,
    constant_field,
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
    valid = rel.validity.group.shifted(rel.n_contact + 2 * rel.n_s)
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


NODES = np.array([[0, 2, 1], [3, 1, 0]])


def field() -> Field:
    """Two components at four nodes, one value of which is fixed and one on a curve."""
    index = np.array([[0, 2, NONE, 4], [1, 3, 5, 6]])
    t, which = ca.SX.sym("t"), np.full((2, 4), NONE)
    which[1, 3] = 0
    bends = Bends(which, (ca.Function("square", [t], [t**2]),))
    return Field(index, np.arange(1.0, 9.0).reshape(2, 4), np.linspace(0, 1, 8).reshape(2, 4), bends=bends)


def columns(values: np.ndarray) -> np.ndarray:
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
    affine = np.where(local.index == NONE, 0.0, 2.0 * local.scale) + local.offset
    np.testing.assert_allclose(straight.values(w), affine, rtol=1e-15)
    assert np.any(straight.values(w) != local.values(w))


def entries(seed: int, shape: tuple[int, int], local: tuple[int, int], *, scaled: bool) -> Entries:
    """Places, some of them taken twice and some dropped."""
    rng = np.random.default_rng(seed)
    row, column = (rng.integers(-1, n, local) for n in shape)
    return Entries(row, column, rng.standard_normal(local) if scaled else np.ones(local))


@pytest.mark.parametrize("shape", [(5, 7), (6, 1), (1, 1)])
@pytest.mark.parametrize("scaled", [False, True])
def test_nonzeros_are_the_sums_of_their_results(shape, scaled) -> None:
    places = [entries(1, shape, (3, 20), scaled=scaled), entries(2, shape, (2, 9), scaled=False)]
    parts, rng, expected, filled = [], np.random.default_rng(3), np.zeros(shape), np.zeros(shape, dtype=bool)
    for place in places:
        length = len(place.row)
        x, local = ca.SX.sym("x", length), rng.standard_normal(place.row.shape)
        parts.append(Part((constant_field(local),), None, ca.Function("double", [x], [2 * x]), [place]))
        for i, j, factor, result in zip(*(np.ravel(values) for values in (*place, 2 * local)), strict=True):
            if i >= 0 and j >= 0:
                expected[i, j] += factor * result
                filled[i, j] = True
    sums = Sums([shape], parts)
    matrix = sums.pattern.astype(float)
    np.testing.assert_array_equal(matrix.data, 1 + np.arange(matrix.nnz))
    (matrix.data,) = sums(np.zeros(0))
    np.testing.assert_allclose(matrix.toarray(), expected, rtol=1e-12, atol=1e-14)
    assert matrix.nnz == (filled.sum() if shape[1] > 1 else shape[0])


MANY = NUMPY_FROM


def triangles(seed: int, n: int, components: int, order: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Corners of upright triangles (6, n) that are not too thin, and displacements (nodes components, n)."""
    rng = np.random.default_rng(seed)
    a, length, angle = rng.uniform(-1, 1, (2, n)), rng.uniform(0.2, 2, (2, n)), rng.uniform(0.2, 2.8, n)
    turn = rng.uniform(0, 2 * np.pi, n)
    b = a + length[0] * np.stack([np.cos(turn), np.sin(turn)])
    c = a + length[1] * np.stack([np.cos(turn + angle), np.sin(turn + angle)])
    return np.concatenate([a, b, c]), rng.standard_normal((3 * order * components, n))


def group(function, at_points: PointSums | None, sizes: list[int], n: int) -> ElementGroup:
    """Elements that share no unknown: all positions first, then all displacements."""
    firsts = np.cumsum([0, *(size * n for size in sizes)])
    local = [unknown_field((size, n), int(first)) for size, first in zip(sizes, firsts, strict=False)]
    return of_energy(function, local, at_points)


def of_energy(function, local: Sequence[Field], at_points: PointSums | None = None) -> ElementGroup:
    return ElementGroup(function, tuple(local), np.zeros((0, local[0].shape[1]), dtype=np.int64), at_points)


def results(groups: list[ElementGroup], x: np.ndarray) -> list[np.ndarray]:
    """Value, gradient and Hessian of the groups as the numeric sums give them."""
    sums = Assembled(groups, ca.MX.sym("x", x.size), ca.MX(0, 1), 0)
    f, gradient, _, _ = sums.first(x, None)
    matrix = sums.second.pattern.astype(float)
    matrix.data[:] = sums.second(x, None, np.array([0.7]), np.zeros(0))[0]
    return [f, gradient, matrix.toarray()]


def agree(groups: list[ElementGroup], x: np.ndarray) -> None:
    """Joined groups with values at points agree with each group by itself, differentiated as a whole."""
    whole = [replace(one, function=one.plain, at_points=None) for one in groups]
    apart = [sum(parts) for parts in zip(*(results([one], x) for one in whole), strict=True)]
    for ours, theirs in zip(results(groups, x), apart, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11 * max(1, np.max(np.abs(theirs))))


def packed(X: np.ndarray, *u: np.ndarray) -> np.ndarray:
    return np.concatenate([part.ravel(order="F") for part in (X, *u)])


def test_sums_that_enter_one_by_one_have_the_derivatives_of_their_function() -> None:
    (X, sums), (x, y) = (ca.SX.sym("X", 4), ca.SX.sym("v", 3)), (ca.SX.sym("x"), ca.SX.sym("y"))
    load = ca.Function("wave", [x, y], [wave(x, y)])
    at_points = PointSums(load, np.array([[1.0, 0.3, 0.0], [0.0, 0.7, 1.0]]), np.eye(3))
    function = ca.Function("f", [X, sums], [ca.sumsqr(sums) * X[0] + ca.exp(sums[1]), ca.SX(0, 1)])
    agree([group(function, at_points, [4], 6)], np.random.default_rng(1).uniform(0, 1, 24))


def test_many_triangles_are_summed_as_few_are() -> None:
    law, n = LAWS["two components"], 2 * MANY + 5  # more than one chunk of points
    X, u = triangles(3, n, 2)
    cell = Straight(3, 2, 1)
    functions = (strain_energy(law, cell), None), load_energy(law, cell, 8)

    def parts(count: int) -> list[ElementGroup]:
        return [group(*function, [6, 6], count) for function in functions]

    def gradient(count: int, x: np.ndarray) -> np.ndarray:
        return Assembled(parts(count), ca.MX.sym("x", x.size), ca.MX(0, 1), 0).first(x, None)[1]

    ours = np.split(gradient(n, packed(X, u)), 2)
    for k in range(0, n, 7):
        theirs = np.split(gradient(1, packed(X[:, [k]], u[:, [k]])), 2)
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(a[6 * k : 6 * k + 6], b, rtol=0, atol=1e-11 * np.max(np.abs(b)))


def test_what_is_kept_follows_the_positions() -> None:
    work = group(*load_energy(LAWS["varying"], Straight(3, 1, 1), 3), [6, 3], 4)
    numeric = Assembled([work], ca.MX.sym("x", 36), ca.MX(0, 1), 0).first
    first, second, again = (packed(*triangles(seed, 4, 1)) for seed in (1, 2, 1))
    before, _, after = numeric(first, None)[1].copy(), numeric(second, None), numeric(again, None)[1]
    np.testing.assert_array_equal(before, after)
    assert not np.allclose(before, numeric(second, None)[1])


@pytest.mark.parametrize("fixed", ["positions", "displacements"])
def test_what_is_fixed_has_no_derivatives(fixed) -> None:
    law, n = LAWS["two components"], 3
    X, u = triangles(5, n, 2)
    fields = [unknown_field((6, n)), constant_field(u)]
    if fixed == "positions":
        fields = [constant_field(X), unknown_field((6, n))]
    cell = Straight(3, 2, 1)
    work, at_points = load_energy(law, cell, 3)
    groups = [of_energy(strain_energy(law, cell), fields), of_energy(work, fields, at_points)]
    agree(groups, (u if fixed == "positions" else X).ravel(order="F"))
