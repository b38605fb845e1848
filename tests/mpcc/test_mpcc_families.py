"""The generated families: the same problem again from the same seed."""

import casadi as ca
import numpy as np
import pytest

from mpcc_library.families import FAMILIES
from rmesh_nlp.mpcc import solve


@pytest.mark.parametrize("name", FAMILIES)
def test_a_seed_makes_the_same_problem_again_and_another_seed_another(name):
    make, sizes = FAMILIES[name]
    one, again, other = (make(sizes[0], seed) for seed in (0, 0, 1))
    assert (one.name, again.name) == (f"{name}-{sizes[0]}-0",) * 2
    x = np.linspace(0.1, 0.9, one.mpcc.n_x)

    def value(instance):
        mpcc = instance.mpcc
        column = ca.vertcat(mpcc.f, mpcc.g, mpcc.G, mpcc.H)
        return ca.Function("value", [mpcc.x], [column])(x).full().ravel()

    assert np.array_equal(value(one), value(again), equal_nan=True)
    if other.mpcc.n_x == x.size:
        assert not np.array_equal(value(one), value(other))


@pytest.mark.parametrize("name", FAMILIES)
def test_the_smallest_of_each_family_is_solved(name):
    make, sizes = FAMILIES[name]
    instance = make(sizes[0], 0)
    result = solve(instance.mpcc, instance.x0)
    assert result.success
    assert result.complementarity <= 1e-8
    assert result.constraint_violation <= 1e-7
