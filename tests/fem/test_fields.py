import casadi as ca
import numpy as np

from rmesh_nlp.fem.fields import CONSTANT, STRAIGHT, Bends, Field, constant_field

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
