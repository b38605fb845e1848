"""What is resolved is a polynomial to Gauss's rule; smooth coefficients are resolved, hidden ones are not."""

import numpy as np
import pytest

from rmesh_nlp.assessment.integrals import gauss
from rmesh_nlp.expressions import Expression
from rmesh_nlp.problem.coefficients import PositionFunction, on_points
from rmesh_nlp.problem.enclosures import resolved
from support.rules import HIDDEN

SMOOTH = (
    "x**3*y - 2/(3 + x) + y**-2",
    "sin(5*x)*cos(4*y) + tan(x/3)",
    "sqrt(1.5 + x)*(2 + y)**1.7 + 2**x",
    "atan(5*(x - 0.3))*atan2(x, 2 + y)",
    "tanh(3*(x - y)) + sinh(x)*cosh(y) - log(2 + x)",
    "exp(-((x - 0.5)**2 + y**2)/0.1)",
    "where(x > 0, x, 2)*max(x, y)*min(x, y)*abs(y)",
)


def cells(width: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners (2, 50, 4) of squares with lower left corners in (-1, 1) x (1.1, 2), and these."""
    low = np.random.default_rng(0).uniform((-1.0, 1.1), (1.0, 2.0), (50, 2)).T
    steps = np.array([[0, 1, 0, 1], [0, 0, 1, 1]])
    return low[..., None] + width * steps[:, None], low


@pytest.mark.parametrize("text", SMOOTH)
@pytest.mark.parametrize("points", [6, 10])
def test_rules_are_exact_on_cells_that_are_resolved(text: str, points: int) -> None:
    smooth, means = Expression(text), []
    for width in (0.6, 0.3, 0.1):
        corners, low = cells(width)
        is_seen, size = resolved(smooth, corners, points)
        for order in (points, 20):
            x, w = gauss(order)
            grid = np.stack([np.repeat(x, order), np.tile(x, order)])
            means.append(on_points(smooth, low[..., None] + width * grid[:, None]) @ np.outer(w, w).ravel())
        cut = np.ptp(np.sign(np.stack([corners[0], corners[0] - corners[1]])), axis=-1).any(axis=0)
        wrong = np.abs(means[-1] - means[-2])[is_seen & ~(cut & ("where" in text))]
        assert np.all(wrong <= 1e-10 * size)
    assert np.all(resolved(smooth, cells(0.02)[0], points)[0])


@pytest.mark.parametrize("hidden", [*HIDDEN[:7], *HIDDEN[10:]])  # not to be cut at switches first
def test_nothing_hides_in_a_cell_that_is_resolved(hidden: PositionFunction) -> None:
    square = np.array([[0, 1, 0, 1], [0, 0, 1, 1]])[:, None]
    assert not resolved(Expression("atan2(y, x)"), square - [[[99]], [[0.5]]], 10)[0]  # nor a cut
    for low, width in ((1.98, 0.02), (0.0, 3.0), (1.989, 0.011)):
        assert not resolved(hidden, low + width * square, 10)[0]


def test_a_product_of_two_members_that_vanish_at_the_centre_varies() -> None:
    square = np.array([[-1, 1, -1, 1], [-1, -1, 1, 1]])[:, None]
    assert not resolved(Expression("atan(1e4*x*y)"), square, 10)[0]
    assert resolved(Expression("atan(1e-4*x*y) + 1"), square, 10)[0]
