"""What is active: signs do not matter, one member of a pair is not enough, bounds have two sides."""

import numpy as np

from rmesh_nlp.optimize.activity import ZERO, both_vanish, is_inside

SMALL, LARGE = 0.5 * ZERO, 2 * ZERO


def test_a_pair_is_weak_only_where_both_members_vanish() -> None:
    one = np.array([SMALL, -SMALL, SMALL, LARGE, -LARGE])
    other = np.array([-SMALL, 0.0, -LARGE, 0.0, SMALL])
    assert both_vanish(one, other).tolist() == [True, True, False, False, False]


def test_a_variable_is_inside_if_it_is_off_both_bounds() -> None:
    lower, upper = np.full(5, -1.0), np.full(5, 1.0)
    upper[4] = np.inf
    x = np.array([-1 + SMALL, -1 + LARGE, 1 - LARGE, 1 - SMALL, 1e6])
    assert is_inside(x, lower, upper).tolist() == [False, True, True, False, True]
