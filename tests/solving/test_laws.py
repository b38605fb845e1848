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


def test_constants_are_what_the_documents_promise() -> None:
    assert TOLERANCE == 1e-6


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
    assert law(-0.1, 3.0, 1.0, 0.0) == pytest.approx(0.5)
    assert law(-1.4, 3.0, 1.0, 0.0) == pytest.approx(0.7)
    nothing = replace(SYSTEM, normals=sp.csr_array((0, 3)), tangents=sp.csr_array((0, 3)),
                      offset=np.zeros(0), slip_bound=np.zeros(0))  # fmt: skip
    assert law_residual(nothing, np.ones(3), np.zeros(0), np.zeros(0)) == 0


def test_a_body_at_rest_is_measured_too() -> None:
    """Nothing moves: without gap and force the laws hold, with a force of 8 across a gap they do not."""
    rest = replace(SMOOTH, offset=np.zeros(1))
    assert law_residual(rest, np.zeros(3), np.zeros(1), np.zeros(0)) == 0
    apart = replace(SMOOTH, offset=np.full(1, 1e-6))
    assert law_residual(apart, np.zeros(3), np.full(1, 8.0), np.zeros(0)) == pytest.approx(1.0)


def test_equilibrium_is_the_largest_force_out_of_balance() -> None:
    """K u - F - N^T lambda - T^T tau by hand: (20 - 8, 10 - 3, 6 - 2) over 8."""
    u = np.array([2.0, 0.5, 0.2])
    found = equilibrium_residual(SYSTEM, u, np.array([3.0]), np.array([2.0]))
    assert found == pytest.approx(12 / 8)
    flat = replace(SYSTEM, load=np.array([20.0, 0, 0]))
    assert equilibrium_residual(flat, u, np.array([3.0]), np.array([2.0])) == pytest.approx(7 / 20)
    assert equilibrium_residual(flat, u, np.array([10.0]), np.array([2.0])) == pytest.approx(4 / 20)
    assert equilibrium_residual(flat, u, np.array([10.0]), np.array([6.0])) == pytest.approx(0, abs=1e-15)
    smooth = replace(flat, slip_bound=np.zeros(0))
    assert equilibrium_residual(smooth, u, np.array([10.0]), np.zeros(0)) == pytest.approx(6 / 20)
