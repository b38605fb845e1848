"""What a result says beside its label: negative curvature, infeasibility, and where a solve has failed."""

import re

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, newton, solve
from rmesh_nlp.mpcc.finish import labelled
from rmesh_nlp.mpcc.lifting import lift
from rmesh_nlp.mpcc.lpec import linearise
from rmesh_nlp.mpcc.newton import curvature
from rmesh_nlp.mpcc.outcome import largest_residual, where_not_finite
from rmesh_nlp.mpcc.result import in_words
from rmesh_nlp.mpcc.stationarity import stationarity
from rmesh_nlp.optimize.status import Status
from support.scripted_run import run_of

z = ca.SX.sym("z", 4)
SADDLE = z[0] * z[1] + z[0] ** 4 + z[1] ** 4
"""Stationary at 0, where its curvature is 1 and -1; its minimum is -1/8 at (1/2, -1/2)."""


def test_a_saddle_is_left_for_the_minimum():
    result = solve(MPCC(z, SADDLE + z[2] + z[3], None, z[2], z[3]), 0.0)
    assert (result.status, result.curvature) == (Status.CONVERGED, "not negative")
    assert result.f == pytest.approx(-1 / 8, abs=1e-8)


@pytest.mark.parametrize(
    ("f", "lam", "said"),
    [
        (z[1] ** 2 - z[0] ** 2 + z[0], [-1.0, -1.0], "not negative"),  # both members have multipliers
        (z[1] ** 2 - z[0] ** 2 + z[2] ** 2, [0.0, -1.0], "not tested"),  # along z0 alone f falls
        (z[1] ** 2 + z[0] ** 2 - z[2] ** 2, [0.0, -1.0], "negative"),
        (z[1] ** 2 + z[0] ** 2 + z[2] ** 2, [0.0, 0.0], "not negative"),
    ],
)
def test_curvature_is_that_along_what_is_active(f, lam, said):
    """Of a biactive pair z0, z1 and a free unknown z2, by the inertia of the KKT matrix."""
    run = run_of(MPCC(z[:3], f, None, z[0], z[1]))
    end = labelled(run, np.zeros(3), 0.0, Status.CONVERGED)
    assert curvature(run, np.zeros(3), end.lin, np.array([*lam, 0.0]), np.zeros(0)) == said


def test_curvature_that_only_an_infeasible_direction_has_is_none():
    """Along z0 and -z1 at once f would fall, but they are the members of one pair."""
    result = solve(MPCC(z[:2], SADDLE, None, z[0], -z[1]), 0.0)
    assert result.f == pytest.approx(0, abs=1e-8)
    assert result.success
    v = ca.SX.sym("v", 204)
    result = solve(MPCC(v, ca.sumsqr(v - 1), None, v[:2], v[2:4]), 0.5)
    assert (result.success, result.curvature) == (True, "not negative")


def test_a_search_that_ran_out_of_nodes_does_not_fall_to_the_weaker_label(monkeypatch):
    """Dense rows leave a family of multipliers, over which a search takes more than one linear program."""
    n = 6
    v = ca.SX.sym("v", 2 * n)
    random = np.random.default_rng(1)
    rows = ca.mtimes(ca.DM(random.normal(size=(3, 2 * n))), v)
    f = ca.dot(ca.DM(random.normal(size=2 * n)), v)
    lifted = lift(MPCC(v, f, rows, v[:n], v[n:], lbg=0, ubg=0))
    lin = linearise(lifted, np.zeros(2 * n), np.ones(1), 1e-8, 1e-8)
    whole = stationarity(lifted, lin, 1e-6).label
    assert whole in ("M", "C", "W")
    for name in ("_NODES", "_LEAST_NODES"):
        monkeypatch.setattr(f"rmesh_nlp.mpcc.stationarity.{name}", 1)
    short = stationarity(lifted, lin, 1e-6).label
    assert short.startswith("at least ")
    assert in_words(short, None, n) == f"undecided, {short} ({n} biactive pairs, B not computed)"


gap, force, speed = (ca.SX.sym(name) for name in ("gap", "force", "speed"))
X = ca.vertcat(gap, force, speed)
NONE = np.zeros(0)


@pytest.mark.parametrize(
    ("f", "g", "words"),
    [
        (ca.log(force), None, r"f is -inf at x.1. .force. = 0."),
        (gap, ca.vertcat(speed, ca.sqrt(gap - 2 + speed)), r"g.1. is nan at x.0. .gap. = 1, x.2. .* = -4."),
        (ca.sqrt(force), None, r"The derivative of f is inf at x.1. .force. = 0."),
        (gap, None, ""),
    ],
)
def test_first_value_that_is_not_finite_is_named_with_its_unknowns(f, g, words):
    found = where_not_finite(lift(MPCC(X, f, g, gap, force)), np.array([1.0, 0.0, -4.0]), NONE)
    assert re.fullmatch(words, found)


@pytest.mark.parametrize(
    ("x", "words"),
    [
        ([0, 0, 7], "The largest residual, 2.0e+00, is in the bounds of x[2] (speed)."),
        ([0, 0, -7], "The largest residual, 6.0e+00, is in g[0], ((gap+speed)-1)."),
        ([-3, 0, 3], "The largest residual, 3.0e+00, is in pair 0, between gap and force."),
        ([0, -3, 3], "The largest residual, 3.0e+00, is in pair 0, between gap and force."),
        ([0.5, 0.25, 0.5], "The largest residual, 2.5e-01, is in pair 0, between gap and force."),
        ([0, 1, 3], ""),
    ],
)
def test_largest_residual_is_named(x, words):
    mpcc = MPCC(X, gap, gap + speed - 1, gap, force, lbx=[-np.inf, -np.inf, -np.inf], ubx=5, lbg=-2)
    g, G, H = (np.array([value], dtype=float) for value in (x[0] + x[2] - 1, x[0], x[1]))
    assert largest_residual(mpcc, np.array(x, dtype=float), g, G, H) == words


def test_message_of_a_failed_solve_names_the_unknown():
    contact, speed = ca.MX.sym("contact", 2), ca.MX.sym("speed")
    x, gap, force = ca.vertcat(contact, speed), contact[0], contact[1]
    start = solve(MPCC(x, ca.log(speed - 2), None, gap, force), 0.0, moves=0)
    assert start.status is Status.EVALUATION_ERROR
    assert "f is nan at x[2] (speed) = 0." in start.message
    # the square root has an infinite slope and no curvature at its minimum
    result = solve(MPCC(x, ca.sqrt(force) + gap**2 + speed**2, None, gap, force), 0.0)
    assert result.curvature == "not tested"


def test_long_expressions_are_shown_by_their_symbols():
    many = ca.SX.sym("v", 9)
    mpcc = MPCC(many, many[0], ca.sumsqr(many) + 1, many[0], many[1], ubg=0)
    values = np.array([1.0]), np.zeros(1), np.zeros(1)
    assert "g[0], a function of v_0, v_1, v_2, v_3, ..." in largest_residual(mpcc, np.zeros(9), *values)


def test_of_a_singular_system_no_curvature_is_known(monkeypatch):
    def singular(*_: object, **__: object) -> None:
        raise RuntimeError("Factor is exactly singular")

    run = run_of(MPCC(z[:2], z[0] ** 2 + z[1] ** 2, None, z[0], z[1]))
    end = labelled(run, np.zeros(2), 0.0, Status.CONVERGED)
    for known, said in ((True, "not negative"), (False, "not tested")):
        if not known:
            monkeypatch.setattr(newton, "splu", singular)
        assert curvature(run, np.zeros(2), end.lin, np.zeros(2), np.zeros(0)) == said
    assert newton.newton(run, np.zeros(2), None) is None
