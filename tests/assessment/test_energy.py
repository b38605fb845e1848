"""Integrals over triangles, arcs and parts between jumps of data, and the energies made of them."""

import itertools
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment import integrals
from rmesh_nlp.assessment.energy import friction_energy, load_vector, stiffness
from rmesh_nlp.assessment.integrals import gauss, over_edges, over_triangles
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.problem import PiecewiseLinear
from rmesh_nlp.problem.body import Body, Edges
from rmesh_nlp.problem.coefficients import Coefficient, PositionFunction, on_points, where
from support.curved import HOLE, plate
from support.rules import HIDDEN


def test_cells_are_cut_until_rules_agree_and_the_rest_is_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = rm.ContactProblem(rm.shapes.rectangle(1, 1, x=(0, 2), y=(0, 2)), rm.Laplace(1.0), ("left",))
    body = Body(problem, problem.mesh.p)
    edges = Edges(body, np.concatenate([problem.mesh.boundaries[side] for side in ("bottom", "top")]))

    def kink(_: Array, shares: Array, __: Array, weights: Array) -> Array:
        return np.sum(np.stack([np.abs(shares[1] - 0.3), shares[1] > 1 / 3]) * weights, axis=2)

    found, doubt, _ = over_edges(edges, kink)
    assert found[0] == pytest.approx(np.full(2, 0.09 + 0.49), abs=1e-6)
    error = np.abs(found[1] - 4 / 3)
    assert np.all((error > 0) & (error < 2 * doubt[1]) & (doubt[1] < 2 / 2**8))
    monkeypatch.setattr(integrals, "CHUNK", 20)  # many parts, the same sums
    np.testing.assert_allclose(over_edges(edges, kink)[0], found, rtol=1e-14)
    assert over_edges(Edges(body, np.zeros(0, dtype=np.int64)), kink)[0].size == 0


@pytest.mark.parametrize("order", [1, 2])
def test_rules_suffice_beside_arcs(order: int, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = replace(plate({"hole": HOLE}), order=order)
    body, space = Body(problem, problem.mesh.p), DisplacementSpace(problem)
    K = stiffness(body, space)[0].toarray()
    monkeypatch.setattr(integrals, "RULES", (14, 16))
    monkeypatch.setattr(integrals, "CHUNK", 40)  # many parts, the same sums
    np.testing.assert_allclose(K, stiffness(body, space)[0].toarray(), atol=10.0 ** (order - 8) * np.max(K))


@pytest.mark.parametrize("order", [1, 2])
def test_resultants_of_loads_are_those_of_the_true_domain(order: int) -> None:
    problem = replace(
        plate({"hole": HOLE}, load=(2.0, -3.0)),
        order=order,
        tractions=(rm.Traction("right", (10.0, 0.0)), rm.Traction("hole", (0.0, 4.0))),
        point_loads=(rm.PointLoad(0, (0.5, 0.25)),),
    )
    load, doubt = load_vector(Body(problem, problem.mesh.p), DisplacementSpace(problem))
    area, arc = 100 - np.pi * 2.5**2, 2 * np.pi * 2.5
    assert load.reshape(-1, 2).sum(axis=0) == pytest.approx(
        [2 * area + 100 + 0.5, -3 * area + 4 * arc + 0.25]
    )
    assert doubt.max() < 1e-9 * np.abs(load).max()


@pytest.mark.parametrize("zeros", [(0.5, 1.7), (0.3, 3.0), (-1.0, 3.0), (0.9, 0.9), (1e-9, 1.0)])
def test_friction_of_a_slip_that_turns_by_hand(zeros: tuple[float, float]) -> None:
    """The integral of (1 + x)^2 |(x - a) (x - b)| from 0 to 2: split at up to two places."""
    problem = rm.ContactProblem(
        rm.shapes.rectangle(1, 1, x=(0, 2)),
        rm.PlaneStrain(1.0, 1.0),
        ("top",),
        rm.Obstacle.graph("bottom", 0.0, friction=lambda x, y: (1 + x) ** 2),
        order=2,
    )
    body, space = Body(problem, problem.mesh.p), DisplacementSpace(problem)
    edges, x = body.edges("bottom"), space.points(problem.mesh.p)[0]
    u = space.coefficients(np.stack([(x - zeros[0]) * (x - zeros[1]), np.full(x.size, 7.0)]))
    anti = (np.polynomial.Polynomial([1, 2, 1]) * np.polynomial.Polynomial.fromroots(zeros)).integ()
    ends = [0.0, *np.clip(zeros, 0, 2), 2.0]
    wanted = sum(abs(anti(high) - anti(low)) for low, high in itertools.pairwise(ends))
    for way in (1, -1):
        found, doubt = friction_energy(edges, problem.obstacles[0], way * u[:, space.nodes_of(edges.ends)])
        assert found == pytest.approx([wanted], rel=1e-12)
        assert doubt[0] < 1e-12


def body(n: int = 3) -> Body:
    problem = rm.ContactProblem(rm.shapes.rectangle(n, 2, x=(0, 2)), rm.Laplace(1.0), ("left",))
    return Body(problem, problem.mesh.p)


def integrand(coefficient: Coefficient) -> Callable[..., Array]:
    return lambda _, __, x, weights: np.sum(on_points(coefficient, x) * weights, axis=1)[None]


def disc(x, y):
    return where((x - 1) ** 2 + (y - 0.5) ** 2 < 0.09, 1.0, 0.0)


@pytest.mark.parametrize(
    ("coefficient", "exact", "within", "is_certain"),
    [
        # where x + y / 2 > 1.1 x is integrated: (4 - (1.1 - y / 2)^2) / 2 over y
        (lambda x, y: where(x + y / 2 > 1.1, x, 0.0), 2 - (1.1**3 - 0.6**3) / 3, 1e-12, True),
        (
            lambda x, y: ca.fabs(x - 0.77) + ca.fmax(y - 0.31, 0),
            0.77**2 / 2 + 1.23**2 / 2 + 0.69**2,
            1e-12,
            True,
        ),
        (lambda x, y: where(ca.logic_and(x > 0.4, y < 0.3), 2.0, 0.0), 2 * 1.6 * 0.3, 1e-12, True),
        (lambda x, y: ca.sign(x - 1) + ca.floor(x), 1.0, 1e-4, False),
        (lambda x, y: ca.floor(3 * x + 0.1), 5.2, 1e-4, False),
        (lambda x, y: where(ca.sin(3 * x) > 0, 1.0, 0.0), np.pi / 3, 1e-5, False),
        (disc, np.pi * 0.09, 1e-3, False),
        # switches that are nearly constant beside their zeros, which are close to a side
        (lambda x, y: where(ca.atan(1e9 * (x - 1.99)) > 0, 1.0, 0.0), 0.01, 1e-6, False),
        (lambda x, y: where(ca.tanh(1e8 * (x + y / 2 - 1.1)) > 0, 1.0, 0.0), 1.15, 1e-6, False),
        # switches of switches
        (lambda x, y: ca.fmax(ca.fabs(x - 1) - ca.fabs(2 * y - 1), 0), 1 / 3, 1e-12, True),
        (lambda x, y: where(where(x > 0.7, 1.0, 2.0) * y > 0.6, 1.0, 0.0), 1.3 * 0.4 + 0.7**2, 1e-12, True),
        (lambda x, y: ca.fmin(ca.fmax(1e12 * (x - 1.99), 0), 1), 0.01, 1e-9, True),
        (
            lambda x, y: where(ca.fabs(x * y - 0.5) < 0.1, 1.0, 0.0),
            0.2 + 0.6 * np.log(2 / 0.6) - 0.4 * np.log(5),
            2e-3,
            False,
        ),
        # what is zero is a distance: a switch may be large elsewhere
        (lambda x, y: where((x - 1.99) * where(x < 1, 1e12, 1) > 0, 1.0, 0.0), 0.01, 1e-9, True),
        (lambda x, y: where(ca.fabs(x - 1.31) < 1e-12, 1e12, 0.0), 2.0, 1e-3, True),
        (lambda x, y: ca.logic_not(ca.exp(1e9 * (x - 1.99))), 1.99, 1e-4, False),
        (lambda x, y: x * x * y, 8 / 6, 1e-12, True),
    ],
)
def test_triangles_are_split_along_jumps_and_kinks(coefficient, exact, within, is_certain):
    whole = body()
    total = over_triangles(whole, np.arange(12), integrand(coefficient), coefficients=(coefficient,))
    assert total.value.sum() == pytest.approx(exact, rel=within)
    assert total.is_certain is is_certain


@pytest.mark.parametrize(
    ("coefficient", "exact", "is_certain"),
    [
        (lambda x, y: where(x <= 1.97, 0.0, -60.0), -1.8, True),
        (lambda x, y: where((x - 0.3) * (x - 0.31) < 0, 1.0, 0.0), 0.01, True),
        (PiecewiseLinear((0.0, 0.7, 2.0), (0.0, 0.7, 0.7)), 0.7**2 / 2 + 0.7 * 1.3, True),
        (lambda x, y: where(ca.cos(2 * x) > 0, 1.0, 0.0), np.pi / 4, False),
        (lambda x, y: where(ca.atan(1e9 * (x - 95 / 48)) > 0, 1.0, 0.0), 1 / 48, False),  # at a sample
        (lambda x, y: where(x > 2 / 3, 3.0, 0.0), 4.0, True),  # at a node
        (lambda x, y: where(ca.fabs(ca.fabs(x - 1) - 0.5) < 1e-3, 1.0, 0.0), 4e-3, True),
        (
            lambda x, y: where(x > 1.3, ca.sqrt(ca.fabs(x - 1.3)), -0.3 * x),
            0.7**1.5 / 1.5 - 0.15 * 1.69,
            True,
        ),
        (lambda x, y: 1 - ca.atan2(1e-30, x - 1.99) / np.pi, 0.01, True),
        (lambda x, y: where((x - 1.99) * where(x < 1, 1e12, 1) > 0, 1.0, 0.0), 0.01, True),
        # zeros whose first six digits are the same
        (lambda x, y: where(x > 1.3, 100.0, 0.0) - where(x > 1.300004, 100.0, 0.0), 4e-4, True),
    ],
)
def test_edges_are_split_at_jumps_and_kinks(coefficient: Coefficient, exact: float, is_certain: bool) -> None:
    top = body().edges("top")
    total = over_edges(top, integrand(coefficient), (coefficient,))
    assert total.value.sum() == pytest.approx(exact, rel=1e-9)
    assert total.is_certain is is_certain
    assert total.doubt.sum() < 1e-9


@pytest.mark.parametrize("hidden", HIDDEN)
def test_what_is_certain_has_no_hidden_parts(hidden: PositionFunction) -> None:
    """Integrals by parts at 1.99 and 1.9995, near which everything is."""
    top, whole = body().edges("top"), body(1)
    ends = np.r_[
        0, 1.5, 1.99 + np.r_[-np.geomspace(0.3, 1e-9, 60), 0, np.geomspace(1e-9, 0.009, 60)], 1.9995, 2
    ]
    x, w = (part[..., None] for part in gauss(8))
    places = np.stack([ends[:-1] + x * np.diff(ends), 0 * ends[1:] + 0 * x])
    exact = float(np.sum(on_points(hidden, places) * w * np.diff(ends)))
    along = over_edges(top, integrand(hidden), (hidden,))
    inside = over_triangles(whole, np.arange(4), integrand(hidden), coefficients=(hidden,))
    for total in (along, inside):
        error = abs(total.value.sum() - exact)
        assert not total.is_certain or error <= total.doubt.sum() + 1e-8 * abs(exact)
    assert abs(along.value.sum() - exact) < (1e-3 if hidden is HIDDEN[-1] else 1e-6) * abs(
        exact
    )  # the root of 1e-9


@pytest.mark.parametrize("switch", [lambda x: (x - 1.3) ** 2 - 1e-14, lambda x: (x - 1.2995) ** 3])
def test_signs_about_a_multiple_zero_are_not_certain(switch: Callable[[Array], Array]) -> None:
    top, whole = body().edges("top"), body()

    def spike(x, y):
        return where(switch(x) < 0, 1.0, 0.0)

    assert not over_edges(top, integrand(spike), (spike,)).is_certain
    assert not over_triangles(whole, np.arange(12), integrand(spike), coefficients=(spike,)).is_certain


def test_friction_that_no_rule_integrates_has_a_doubt_that_holds() -> None:
    """The integral of the root of x from 0 to 2 is 4 / 3 of the root of 2."""
    problem = rm.ContactProblem(
        rm.shapes.rectangle(1, 1, x=(0, 2)),
        rm.PlaneStrain(1.0, 1.0),
        ("top",),
        rm.Obstacle.graph("bottom", 0.0, friction=lambda x, y: ca.sqrt(x)),
    )
    edges = Body(problem, problem.mesh.p).edges("bottom")
    found, doubt = friction_energy(edges, problem.obstacles[0], np.ones((2, 2, 1)))
    assert 0 < abs(found[0] - 4 / 3 * np.sqrt(2)) <= doubt[0]
