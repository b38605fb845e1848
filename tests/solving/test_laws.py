"""Residuals of equilibrium, contact and friction laws by hand, at one node."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.assessment.assessor import TOLERANCE, equilibrium_residual, law_residual
from rmesh_nlp.contact.system import ContactSystem

SYSTEM = ContactSystem(
    stiffness=sp.csc_array(np.diag([10.0, 20.0, 30.0])),
    load=np.array([8.0, 0.0, 0.0]),
    constant=0.0,
    normals=sp.csr_array(np.array([[0.0, 1.0, 0.0]])),
    tangents=sp.csr_array(np.array([[0.0, 0.0, 1.0]])),
    offset=np.array([0.5]),
    slip_bound=np.array([4.0]),
)
"""The largest applied force, the unit of forces, is 8."""

SMOOTH = replace(SYSTEM, slip_bound=np.zeros(0))


def law(gap: float, force: float, slip: float = 0.0, friction: float = 0.0, system: Any = SYSTEM) -> float:
    """With the largest displacement 2."""
    u = np.array([2.0, gap - 0.5, slip])
    return law_residual(system, u, np.array([force]), np.array([friction]))


@pytest.mark.parametrize(
    ("gap", "force", "residual"),
    [
        (0.0, 3.0, 0.0),  # touches
        (0.7, 0.0, 0.0),  # open
        (-0.1, 3.0, 0.05),  # penetrates by a twentieth of the largest displacement
        (-0.1, 0.0, 0.05),
        (0.7, -0.4, 0.05),  # pulls with a twentieth of the largest force
        (0.2, 0.4, 0.05),  # both: the smaller one
        (0.05, 4.0, 0.025),
    ],
)
def test_the_contact_law(gap: float, force: float, residual: float) -> None:
    assert law(gap, force, system=SMOOTH) == pytest.approx(residual, abs=1e-15)
    assert law(gap, force, 0.0, 1.0) == pytest.approx(residual, abs=1e-15)  # sticks within the bound


@pytest.mark.parametrize(
    ("slip", "friction", "residual"),
    [
        (0.0, 3.9, 0.0),  # sticks
        (1.0, -4.0, 0.0),  # slides against the friction
        (-1.0, 4.0, 0.0),
        (2.0, 4.0, 1.0),  # is pulled along: 4 + 4 in units of 8
        (1.0, 0.0, 0.5),  # slides without friction: 4 of 8
        (0.25, -3.0, 0.125),  # slip 0.25 / 2 * 8 = 1, less than the reserve of the friction
        (0.0, 5.0, 0.125),  # above the bound
    ],
)
def test_the_friction_law(slip: float, friction: float, residual: float) -> None:
    assert law(0.0, 3.0, slip, friction) == pytest.approx(residual, abs=1e-15)


def test_the_worst_of_both_laws_counts() -> None:
    assert TOLERANCE == 1e-6  # what the documents promise
    assert law(-0.1, 3.0, 1.0, 0.0) == pytest.approx(0.5)
    assert law(-1.4, 3.0, 1.0, 0.0) == pytest.approx(0.7)
    none, no_rows = np.zeros(0), sp.csr_array((0, 3))
    nothing = replace(SYSTEM, normals=no_rows, tangents=no_rows, offset=none, slip_bound=none)
    assert law_residual(nothing, np.ones(3), none, none) == 0


@pytest.mark.parametrize(("gap", "force", "residual"), [(0.0, 0.0, 0.0), (1e-6, 8.0, 1.0)])
def test_a_body_at_rest_is_measured_too(gap: float, force: float, residual: float) -> None:
    """Nothing moves: without gap and force the laws hold, with a force of 8 across a gap they do not."""
    rest = replace(SMOOTH, offset=np.full(1, gap))
    assert law_residual(rest, np.zeros(3), np.full(1, force), np.zeros(0)) == pytest.approx(residual)


@pytest.mark.parametrize(
    ("load", "normal", "friction", "residual"),
    [(8.0, 3.0, 2.0, 12 / 8), (20.0, 3.0, 2.0, 7 / 20), (20.0, 10.0, 2.0, 4 / 20), (20.0, 10.0, 6.0, 0.0),
     (20.0, 10.0, None, 6 / 20)],
)  # fmt: skip
def test_equilibrium_is_the_largest_force_out_of_balance(
    load: float, normal: float, friction: float | None, residual: float
) -> None:
    """K u - F - N^T lambda - T^T tau by hand: (20 - F, 10 - lambda, 6 - tau) over F."""
    system = replace(SMOOTH if friction is None else SYSTEM, load=np.array([load, 0.0, 0.0]))
    tau = np.zeros(0) if friction is None else np.array([friction])
    found = equilibrium_residual(system, np.array([2.0, 0.5, 0.2]), np.array([normal]), tau)
    assert found == pytest.approx(residual, abs=1e-15)
