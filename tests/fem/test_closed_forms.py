from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rmesh_nlp.discretisation import discretise
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.assembly import Assembled, element_values
from rmesh_nlp.fem.closed_forms import CHUNK, Strain
from rmesh_nlp.fem.distortion import DISTORTIONS, Distortion, differentiated_density, distortion_group
from rmesh_nlp.fem.element import PointValues
from rmesh_nlp.fem.energy import load_energy, strain_energy, triangle_rule
from rmesh_nlp.fem.fields import ElementGroup, constant_field, element_group, unknown_field
from rmesh_nlp.fem.functional import scaled_group
from rmesh_nlp.fem.load_moments import Load
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.problem import Laplace, PlaneStrain, PlaneStress
from rmesh_nlp.vectorised import AssemblySettings


def wave(x, y):
    return ca.sin(2 * x + y) + ca.if_else(x < y, x * y, y**3)


LAWS = {
    "laplace": Laplace(wave, conductivity=2.5),
    "constant load": Laplace(3.0),
    "plane strain": PlaneStrain(1.3, 0.7, (wave, lambda x, y: ca.exp(x - y))),
    "negative lambda": PlaneStrain(-0.3, 0.7, (1.0, lambda x, y: x * y)),
    "plane stress": PlaneStress.from_young(2.0, 0.3, (lambda x, y: y, -1.0)),
}


def triangles(seed: int, n: int, components: int, order: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Corners of upright triangles (6, n) that are not too thin, and displacements (nodes components, n)."""
    rng = np.random.default_rng(seed)
    a, length, angle = rng.uniform(-1, 1, (2, n)), rng.uniform(0.2, 2, (2, n)), rng.uniform(0.2, 2.8, n)
    turn = rng.uniform(0, 2 * np.pi, n)
    b = a + length[0] * np.stack([np.cos(turn), np.sin(turn)])
    c = a + length[1] * np.stack([np.cos(turn + angle), np.sin(turn + angle)])
    return np.concatenate([a, b, c]), rng.standard_normal((3 * order * components, n))


def group(function, at_points: PointValues | None, closed, sizes: list[int], n: int) -> ElementGroup:
    """Triangles that share no unknown: all positions first, then all displacements."""
    firsts = np.cumsum([0, *(size * n for size in sizes)])
    local = [unknown_field((size, n), int(first)) for size, first in zip(sizes, firsts, strict=False)]
    return replace(element_group(function, local[0], tuple(local)), at_points=at_points, closed=closed)


def results(groups: list[ElementGroup], x: np.ndarray, leading: int | None = None) -> list[np.ndarray]:
    """Value, gradient and Hessian of the groups as the numeric sums give them."""
    sums = Assembled(groups, ca.MX.sym("x", x.size), ca.MX(0, 1), 0)
    f, gradient = sums.numeric("gradient")(x)
    hessian = sums.numeric("hessian", leading)
    matrix = hessian.sums[0].numbered.astype(float)
    matrix.data[:] = hessian(x, None, np.array([0.7]), np.zeros(0))[0]
    return [f, gradient, matrix.toarray()]


def agree(groups: list[ElementGroup], x: np.ndarray, rounding: float = 1e-11) -> None:
    mapped = [replace(one, closed=None) for one in groups]
    for ours, theirs in zip(results(groups, x), results(mapped, x), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=rounding * max(1, np.max(np.abs(theirs))))
    ours, theirs = (np.sum(element_values(those)(x), axis=0) for those in (groups, mapped))
    np.testing.assert_allclose(ours, theirs, rtol=rounding, atol=rounding)


def packed(X: np.ndarray, *u: np.ndarray) -> np.ndarray:
    return np.concatenate([part.ravel(order="F") for part in (X, *u)])


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", LAWS)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_strain_energy_is_that_of_its_function(name, order, seed) -> None:
    law = LAWS[name]
    X, u = triangles(seed, 3, law.components, order)
    agree([group(strain_energy(law, order), None, Strain(law, order), [6, len(u)], 3)], packed(X, u))


@pytest.mark.parametrize(("rule", "order"), [("midpoint", 1), (3, 1), (6, 1), (3, 2), (6, 2)])
@pytest.mark.parametrize("name", LAWS)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=3, deadline=None)
def test_work_of_a_load_is_that_of_its_function(name, rule, order, seed) -> None:
    law = LAWS[name]
    X, u = triangles(seed, 3, law.components, order)
    function, at_points = load_energy(law, rule, order)
    closed = Load(at_points.function, triangle_rule(rule), order)
    agree([group(function, at_points, closed, [6, len(u)], 3)], packed(X, u))


@pytest.mark.parametrize("name", DISTORTIONS)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_distortion_is_that_of_its_function(name, seed) -> None:
    (X, _), (X0, _) = triangles(seed, 3, 1), triangles(seed + 1, 3, 1)
    problem = replace(EXAMPLES["6.1"](n=2), reference=X0.reshape(3, 2, 3).transpose(1, 0, 2))
    problem = _with_triangles(problem, 3)
    agree([distortion_group(problem, unknown_field((2, 9)), name)], X.ravel(order="F"), 1e-9)


def _with_triangles(problem, n: int):
    """A problem of as many triangles that share no vertex, as far as a distortion asks."""

    class Apart:
        mesh = type("Mesh", (), {"t": np.arange(3 * n).reshape(n, 3).T})
        triangles = mesh.t
        reference = problem.reference

    return Apart()


def test_a_flat_or_inverted_triangle_has_no_distortion() -> None:
    X0 = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]]).T
    closed = Distortion(
        differentiated_density(DISTORTIONS["quality"]), X0.reshape(3, 2, 1).transpose(1, 0, 2), np.ones(1)
    )
    function = ca.Function("unused", [ca.SX.sym("X", 6)], [ca.SX(0), ca.SX(0, 1)])
    for height, defined in ((0.5, True), (0.0, False), (-0.5, False)):
        x = np.array([0.0, 0.0, 1.0, 0.0, 0.0, height])
        (value,) = element_values([group(function, None, closed, [6], 1)])(x)
        assert np.isfinite(value[0]) == defined


def test_energies_of_the_same_triangles_are_added_up() -> None:
    law, n = LAWS["plane strain"], CHUNK + 5  # more than one chunk
    X, u = triangles(3, n, law.components)
    function, at_points = load_energy(law, 3)
    groups = [
        group(strain_energy(law), None, Strain(law), [6, 6], n),
        scaled_group(group(function, at_points, Load(at_points.function, triangle_rule(3)), [6, 6], n), -2.0),
    ]
    x = packed(X, u)
    sums = Assembled(groups, ca.MX.sym("x", x.size), ca.MX(0, 1), 0).numeric("hessian").sums[0]
    assert sums.n_local == 78 * n
    ours, theirs = (
        Assembled(those, ca.MX.sym("x", x.size), ca.MX(0, 1), 0).numeric("gradient")(x)
        for those in (groups, [replace(one, closed=None) for one in groups])
    )
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-11 * np.max(np.abs(b)))


def test_moments_follow_the_positions() -> None:
    law = LAWS["laplace"]
    function, at_points = load_energy(law, 3)
    one = group(function, at_points, Load(at_points.function, triangle_rule(3)), [6, 3], 4)
    numeric = Assembled([one], ca.MX.sym("x", 36), ca.MX(0, 1), 0).numeric("gradient")
    first, second, again = (packed(*triangles(seed, 4, 1)) for seed in (1, 2, 1))
    before, _, after = numeric(first)[1].copy(), numeric(second), numeric(again)[1]
    np.testing.assert_array_equal(before, after)
    assert not np.allclose(before, numeric(second)[1])


@pytest.mark.parametrize("fixed", ["positions", "displacements"])
def test_what_is_fixed_has_no_derivatives(fixed) -> None:
    law, n = LAWS["plane strain"], 3
    X, u = triangles(5, n, 2)
    fields = [unknown_field((6, n)), constant_field(u)]
    if fixed == "positions":
        fields = [constant_field(X), unknown_field((6, n))]
    function, at_points = load_energy(law, 3)
    energies = [
        replace(element_group(strain_energy(law), fields[0], tuple(fields)), closed=Strain(law)),
        replace(
            element_group(function, fields[0], tuple(fields)),
            at_points=at_points,
            closed=Load(at_points.function, triangle_rule(3)),
        ),
    ]
    agree(energies, (u if fixed == "positions" else X).ravel(order="F"))


def test_leading_rows_are_those_of_the_whole() -> None:
    rel = relocation(EXAMPLES["6.3"]((4, 2)), parse_objective("energy + 3*shape-size"))
    x = np.random.default_rng(0).uniform(-0.1, 0.1, rel.n_x)
    groups = [*rel.energies]
    whole, part = results(groups, x), results(groups, x, rel.n_q)
    np.testing.assert_allclose(part[2][: rel.n_q], whole[2][: rel.n_q], rtol=1e-12)
    assert not np.any(part[2][rel.n_q :])
    assert np.any(whole[2][rel.n_q :])


def test_tied_unknowns_fold_onto_the_diagonal() -> None:
    problem = EXAMPLES["6.1"](4, 0.1)
    inside = problem.mesh.interior_nodes()
    edge = next(e for e in problem.mesh.facets.T.tolist() if set(e) <= set(inside.tolist()))
    tied = replace(problem, motion=replace(problem.motion, tied=(tuple(edge),)))
    rel = relocation(discretise(tied, AssemblySettings(numpy_from=10**9)))
    x = np.random.default_rng(0).uniform(-0.5, 0.5, rel.n_x)
    ours = results(list(rel.energies), x)[2]
    theirs = rel.nlp.derivatives.hess_lag(x, [], 0.7, np.zeros(rel.n_rows)).full()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * np.max(np.abs(theirs)))
