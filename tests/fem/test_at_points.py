from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import Assembled
from rmesh_nlp.fem.at_points import PointValues
from rmesh_nlp.fem.contact_terms import friction_energy
from rmesh_nlp.fem.element import plain
from rmesh_nlp.fem.energy import load_energy, strain_energy
from rmesh_nlp.fem.fields import ElementGroup, constant_field, element_group, unknown_field
from rmesh_nlp.fem.functional import scaled_group
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.problem import Laplace, PlaneStrain
from rmesh_nlp.vectorised import USUAL, AssemblySettings
from support.problems import tied_neighbours


def wave(x, y):
    return ca.sin(2 * x + y) + ca.if_else(x < y, x * y, y**3)


LAWS = {
    "varying": Laplace(wave, conductivity=2.5),
    "constant": Laplace(3.0),
    "two components": PlaneStrain(1.3, 0.7, (wave, lambda x, y: ca.exp(x - y))),
}
MANY = USUAL.numpy_from


def triangles(seed: int, n: int, components: int, order: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Corners of upright triangles (6, n) that are not too thin, and displacements (nodes components, n)."""
    rng = np.random.default_rng(seed)
    a, length, angle = rng.uniform(-1, 1, (2, n)), rng.uniform(0.2, 2, (2, n)), rng.uniform(0.2, 2.8, n)
    turn = rng.uniform(0, 2 * np.pi, n)
    b = a + length[0] * np.stack([np.cos(turn), np.sin(turn)])
    c = a + length[1] * np.stack([np.cos(turn + angle), np.sin(turn + angle)])
    return np.concatenate([a, b, c]), rng.standard_normal((3 * order * components, n))


def group(function, at_points: PointValues | None, sizes: list[int], n: int) -> ElementGroup:
    """Elements that share no unknown: all positions first, then all displacements."""
    firsts = np.cumsum([0, *(size * n for size in sizes)])
    local = [unknown_field((size, n), int(first)) for size, first in zip(sizes, firsts, strict=False)]
    return replace(element_group(function, local[0], tuple(local)), at_points=at_points)


def results(groups: list[ElementGroup], x: np.ndarray, leading: int | None = None) -> list[np.ndarray]:
    """Value, gradient and Hessian of the groups as the numeric sums give them."""
    sums = Assembled(groups, ca.MX.sym("x", x.size), ca.MX(0, 1), 0)
    f, gradient = sums.gradient(x)
    hessian = sums.hessian(leading)
    matrix = hessian.pattern.astype(float)
    matrix.data[:] = hessian(x, None, np.array([0.7]), np.zeros(0))[0]
    return [f, gradient, matrix.toarray()]


def agree(groups: list[ElementGroup], x: np.ndarray) -> None:
    """Joined groups with values at points agree with each group by itself, differentiated as a whole."""
    whole = [replace(one, function=plain(one.function, one.at_points), at_points=None) for one in groups]
    apart = [sum(parts) for parts in zip(*(results([one], x) for one in whole), strict=True)]
    for ours, theirs in zip(results(groups, x), apart, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11 * max(1, np.max(np.abs(theirs))))


def packed(X: np.ndarray, *u: np.ndarray) -> np.ndarray:
    return np.concatenate([part.ravel(order="F") for part in (X, *u)])


@pytest.mark.parametrize(("rule", "order"), [("midpoint", 1), (6, 1), (3, 2)])
@pytest.mark.parametrize("name", LAWS)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=3, deadline=None)
def test_energy_of_triangles_has_the_derivatives_of_its_parts(name, rule, order, seed) -> None:
    law = LAWS[name]
    X, u = triangles(seed, 3, law.components, order)
    sizes, (work, at_points) = [6, len(u)], load_energy(law, rule, order)
    parts = [group(strain_energy(law, order), None, sizes, 3), group(work, at_points, sizes, 3)]
    agree([*parts, scaled_group(parts[1], -2.5)], packed(X, u))


@pytest.mark.parametrize("order", [1, 2])
def test_friction_on_edges_has_the_derivatives_of_its_function(order) -> None:
    function, at_points = friction_energy(wave, order)
    X, s = np.random.default_rng(3).uniform(0, 1, (4, 5)), np.ones((order + 1, 5))
    agree([group(function, at_points, [4, order + 1], 5)], packed(X, s))


def test_values_that_enter_one_by_one_have_the_derivatives_of_their_function() -> None:
    """As distances to a foundation do, whose gaps are not linear in them."""
    at_points = PointValues.of(wave, np.array([[1.0, 0.3, 0.0], [0.0, 0.7, 1.0]]))
    X, values = ca.SX.sym("X", 4), ca.SX.sym("v", 3)
    function = ca.Function("f", [X, values], [ca.sumsqr(values) * X[0] + ca.exp(values[1]), ca.SX(0, 1)])
    agree([group(function, at_points, [4], 6)], np.random.default_rng(1).uniform(0, 1, 24))


def test_many_triangles_are_summed_as_few_are() -> None:
    law, n = LAWS["two components"], 2 * MANY + 5  # more than one chunk of points
    X, u = triangles(3, n, 2)
    work, at_points = load_energy(law, 8)

    def parts(count: int) -> list[ElementGroup]:
        sizes = [6, 6]
        return [group(strain_energy(law), None, sizes, count), group(work, at_points, sizes, count)]

    def gradient(count: int, x: np.ndarray) -> np.ndarray:
        return Assembled(parts(count), ca.MX.sym("x", x.size), ca.MX(0, 1), 0).gradient(x)[1]

    ours = np.split(gradient(n, packed(X, u)), 2)
    for k in range(0, n, 7):
        theirs = np.split(gradient(1, packed(X[:, [k]], u[:, [k]])), 2)
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(a[6 * k : 6 * k + 6], b, rtol=0, atol=1e-11 * np.max(np.abs(b)))


def test_what_is_kept_follows_the_positions() -> None:
    work, at_points = load_energy(LAWS["varying"], 3)
    numeric = Assembled([group(work, at_points, [6, 3], 4)], ca.MX.sym("x", 36), ca.MX(0, 1), 0).gradient
    first, second, again = (packed(*triangles(seed, 4, 1)) for seed in (1, 2, 1))
    before, _, after = numeric(first)[1].copy(), numeric(second), numeric(again)[1]
    np.testing.assert_array_equal(before, after)
    assert not np.allclose(before, numeric(second)[1])


@pytest.mark.parametrize("fixed", ["positions", "displacements"])
def test_what_is_fixed_has_no_derivatives(fixed) -> None:
    law, n = LAWS["two components"], 3
    X, u = triangles(5, n, 2)
    fields = [unknown_field((6, n)), constant_field(u)]
    if fixed == "positions":
        fields = [constant_field(X), unknown_field((6, n))]
    work, at_points = load_energy(law, 3)
    strain, load = (element_group(one, fields[0], tuple(fields)) for one in (strain_energy(law), work))
    agree([strain, replace(load, at_points=at_points)], (u if fixed == "positions" else X).ravel(order="F"))


def test_leading_rows_are_those_of_the_whole() -> None:
    rel = relocation(EXAMPLES["6.3"]((4, 2)), parse_objective("energy + 3*shape-size"))
    x = np.random.default_rng(0).uniform(-0.1, 0.1, rel.n_x)
    whole, part = results([*rel.energies], x), results([*rel.energies], x, rel.n_q)
    np.testing.assert_allclose(part[2][: rel.n_q], whole[2][: rel.n_q], rtol=1e-12)
    assert not np.any(part[2][rel.n_q :])
    assert np.any(whole[2][rel.n_q :])


def test_tied_unknowns_fold_onto_the_diagonal() -> None:
    rel = relocation(discretise(tied_neighbours(), AssemblySettings(numpy_from=10**9)))
    x = np.random.default_rng(0).uniform(-0.5, 0.5, rel.n_x)
    ours = results(list(rel.energies), x)[2]
    theirs = rel.nlp.derivatives.hess_lag(x, [], 0.7, np.zeros(rel.n_rows)).full()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * np.max(np.abs(theirs)))
