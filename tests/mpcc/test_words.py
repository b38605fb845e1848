"""What a result says beside its label: negative curvature, local infeasibility, searches that ran out."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.mpcc import MPCC, solve
from rmesh_nlp.mpcc.lifting import lift
from rmesh_nlp.mpcc.lpec import linearise
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.phase_one import phase_one
from rmesh_nlp.mpcc.result import in_words
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.mpcc.stationarity import _PIECES, stationarity
from rmesh_nlp.optimize.status import Status

z = ca.SX.sym("z", 4)
SADDLE = z[0] * z[1] + z[0] ** 4 + z[1] ** 4
"""Stationary at 0, where its curvature is 1 and -1; its minimum is -1/8 at (1/2, -1/2)."""


@pytest.mark.parametrize(
    ("G", "H"),
    [
        (z[2], z[3]),  # the pair knows nothing of the saddle
        (ca.vertcat(z[2], z[3]), ca.vertcat(z[0] + z[2], z[3] - z[1])),  # both pairs are biactive at 0
    ],
)
def test_a_saddle_is_left_for_the_minimum(G, H):
    result = solve(MPCC(z, SADDLE + z[2] + z[3], None, G, H), 0.0)
    assert (result.status, result.curvature) == (Status.CONVERGED, "not negative")
    assert result.f == pytest.approx(-1 / 8, abs=1e-8)


def test_curvature_that_only_an_infeasible_direction_has_is_none():
    """Along z0 and -z1 at once f would fall, but they are the members of one pair."""
    result = solve(MPCC(z[:2], SADDLE, None, z[0], -z[1]), 0.0)
    assert result.f == pytest.approx(0, abs=1e-8)
    assert result.success


def test_large_problems_say_that_curvature_was_not_tested():
    v = ca.SX.sym("v", 204)
    result = solve(MPCC(v, ca.sumsqr(v - 1), None, v[:2], v[2:4]), 0.5)
    assert (result.success, result.curvature) == (True, "not tested")


def certified(mpcc, start):
    nlps = CompiledNLPs(mpcc, Options())
    z = nlps.lifted.start(np.array(start, float), np.zeros(0))
    return phase_one(Run(nlps, np.zeros(0)), z, only_violation=True).status is Status.INFEASIBLE


@pytest.mark.parametrize(
    ("rows", "bounds", "is_infeasible"),
    [
        (z[0] ** 2 + z[1] ** 2, {"ubg": -1}, True),
        (z[0] * z[1], {"lbg": 1}, True),
        (z[0] + z[1], {"lbg": 1}, False),
        ((z[0] - 3) ** 2 * z[0], {"lbg": 5}, True),  # at 1, where the row is 4; it holds from 4.5 on
        (z[0] ** 2, {"lbg": 5}, False),
    ],
)
def test_infeasible_is_what_has_a_local_minimum_of_the_violation(rows, bounds, is_infeasible):
    assert certified(MPCC(z[:2], z[0], rows, z[0], z[1], **bounds), [0.3, 0.2]) is is_infeasible


def test_infeasible_is_never_said_after_an_iteration_limit():
    mpcc = MPCC(z[:2], z[0], ca.exp(z[0]) + z[1], z[0], z[1], lbg=2)
    result = solve(mpcc, [3.0, 1.0], ipopt_relaxed={"max_iter": 1}, ipopt_exact={"max_iter": 1})
    assert result.success or result.status is not Status.INFEASIBLE


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
    assert whole in _PIECES or whole == "W"
    for name in ("_NODES", "_LEAST_NODES"):
        monkeypatch.setattr(f"rmesh_nlp.mpcc.stationarity.{name}", 1)
    short = stationarity(lifted, lin, 1e-6).label
    assert short.startswith("at least ")
    assert in_words(short, None, n) == f"undecided, {short} ({n} biactive pairs, B not computed)"
