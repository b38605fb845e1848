"""Bounds of the certificate in the place of extrapolated errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.campaign.cases import Case
from rmesh_nlp.campaign.run import solve as solve_case
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import Motion
from rmesh_nlp.solution.certify import Certificate
from rmesh_nlp.solution.worth import Worth, by_certificate

NONE = np.zeros(0)
CERTIFICATE = Certificate(-1.2, -1.1, 0.8, 0.4, 0.4, 0.2, True, True, True, "", NONE, NONE, NONE, 0.0)
FOUND = Worth(0.3, 0.1, "extrapolated", 3.0, 100, 300, 150, 40)


def test_errors_are_bounds_and_the_factor_is_their_ratio() -> None:
    row = by_certificate(FOUND.record(), CERTIFICATE)
    assert row["source"] == "certified"
    assert (row["error_initial"], row["error"]) == pytest.approx((0.32, 0.08))
    assert row["factor"] == pytest.approx(4.0)
    assert (row["uniform_nodes"], row["adaptive_nodes"]) == (400, 200)
    assert "at most 0.32 before" in row["text"]
    assert "at least 4 times less" in row["text"]


def test_what_is_not_guaranteed_is_said_and_what_is_exact_stays() -> None:
    row = by_certificate(FOUND.record(), replace(CERTIFICATE, guaranteed_lower=False))
    assert row["source"] == "bracket"
    assert "at least" not in row["text"]
    assert "not guaranteed" in row["text"]
    exact = replace(FOUND, source="exact").record()
    assert by_certificate(exact, CERTIFICATE) == exact
    curved = replace(FOUND, gain_geometry=0.01).record()
    assert by_certificate(curved, CERTIFICATE) == curved


@pytest.mark.slow
def test_a_certified_solve_has_it_and_the_bound_of_the_factor_holds() -> None:
    exact = EXAMPLES["6.1"](n=4).exact
    assert exact is not None
    problem = replace(EXAMPLES["6.1"](n=4), exact=None, quadrature=8, motion=Motion(delta=None))
    outcome = solve_case(Case(problem, "auto", certify=True))
    row = outcome.record
    found = row["worth"]
    assert found["source"] == "certified"
    true = [row[f"energy_{name}audited"] - exact.energy for name in ("initial_", "")]
    assert found["error_initial"] >= true[0]
    assert found["error"] >= true[1]
    assert found["factor"] <= true[0] / true[1]
    assert outcome.solution is not None
    assert outcome.solution.extra["worth"] == found
