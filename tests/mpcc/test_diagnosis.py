"""What a failed solve says of the place where it failed."""

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, solve
from rmesh_nlp.mpcc.diagnosis import largest_residual, where_not_finite
from rmesh_nlp.mpcc.lifting import lift
from rmesh_nlp.optimize.status import Status

gap, force, speed = (ca.SX.sym(name) for name in ("gap", "force", "speed"))
X = ca.vertcat(gap, force, speed)
NONE = np.zeros(0)


def as_mx():
    """The same names as MX symbols, two of them in one."""
    pair, speed = ca.MX.sym("contact", 2), ca.MX.sym("speed")
    return ca.vertcat(pair, speed), pair[0], pair[1], speed


@pytest.mark.parametrize(
    ("f", "g", "words"),
    [
        (ca.log(force), None, r"f is -inf at x.1. .force. = 0."),
        (
            gap,
            ca.vertcat(speed, ca.sqrt(gap - 2 + speed)),
            r"g.1. is nan at x.0. .gap. = 1, x.2. .speed. = -4.",
        ),
        (ca.sqrt(force), None, r"The derivative of f is inf at x.1. .force. = 0."),
        (gap, None, ""),
    ],
)
def test_first_value_that_is_not_finite_is_named_with_its_unknowns(f, g, words):
    found = where_not_finite(MPCC(X, f, g, gap, force), np.array([1.0, 0.0, -4.0]), NONE)
    assert re.fullmatch(words, found)


def test_assembled_model_names_the_function_alone():
    mpcc = MPCC(X, ca.log(force), None, gap, force)
    mpcc = replace(mpcc, derivatives=lift(mpcc).base)
    assert where_not_finite(mpcc, np.array([1.0, 0.0, 0.0]), NONE) == "f is -inf."
    assert where_not_finite(mpcc, np.array([1.0, 1.0, 0.0]), NONE) == ""


@pytest.mark.parametrize(
    ("x", "words"),
    [
        ([0, 0, 7], "The largest residual, 2.0e+00, is in the bounds of x[2] (speed)."),
        ([0, 0, -7], "The largest residual, 6.0e+00, is in g[0], ((gap+speed)-1)."),
        ([-3, 0, 3], "The largest residual, 3.0e+00, is in pair 0, between gap and force."),
        ([0.5, 0.25, 0.5], "The largest residual, 2.5e-01, is in pair 0, between gap and force."),
        ([0, 1, 3], ""),
    ],
)
def test_largest_residual_is_named(x, words):
    mpcc = MPCC(X, gap, gap + speed - 1, gap, force, lbx=[-np.inf, -np.inf, -np.inf], ubx=5, lbg=-2)
    g, G, H = (np.array([value], dtype=float) for value in (x[0] + x[2] - 1, x[0], x[1]))
    assert largest_residual(mpcc, np.array(x, dtype=float), g, G, H) == words


def test_message_of_a_failed_solve_names_the_unknown():
    x, gap, force, speed = as_mx()
    start = solve(MPCC(x, ca.log(speed - 2), None, gap, force), 0.0, moves=0)
    assert start.status is Status.EVALUATION_ERROR
    assert "f is nan at x[2] (speed) = 0." in start.message
    never = solve(MPCC(x, gap, gap**2 + 1, gap, force, ubg=0), 0.5)
    assert never.status is Status.INFEASIBLE
    assert "is in g[0]" in never.message


def test_a_derivative_that_is_not_finite_is_no_crash():
    """The square root has an infinite slope and no curvature at its minimum."""
    result = solve(MPCC(X, ca.sqrt(force) + gap**2 + speed**2, None, gap, force), 0.0)
    assert result.curvature == "not tested"


def test_long_expressions_are_shown_by_their_symbols():
    many = ca.SX.sym("v", 9)
    mpcc = MPCC(many, many[0], ca.sumsqr(many) + 1, many[0], many[1], ubg=0)
    values = np.array([1.0]), np.zeros(1), np.zeros(1)
    assert "g[0], a function of v_0, v_1, v_2, v_3, ..." in largest_residual(mpcc, np.zeros(9), *values)
