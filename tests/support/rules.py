"""Quadrature that is coarse, so that its doubts are large, and loads of which no rule sees all."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.assessment import integrals
from rmesh_nlp.problem.coefficients import PositionFunction, where


def coarsen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two and three Gauss points per direction are compared, and no cell is cut."""
    for name, value in (("RULES", (2, 3)), ("HIGHER", (2, 3)), ("DEPTH", 0), ("DEEPEST", 1)):
        monkeypatch.setattr(integrals, name, value)


HIDDEN: tuple[PositionFunction, ...] = (
    lambda x, y: -0.5 * (1 - ca.atan2(1e-30, x - 1.99) / np.pi),
    lambda x, y: -0.5 * ca.atan(1 / (1e-9 * (x - 1.9995))),
    lambda x, y: -0.5 * ca.tanh(1e9 * (x - 1.99)),
    lambda x, y: -50 * ca.exp(-1e8 * (x - 1.99) ** 2),
    lambda x, y: -1e-5 / (1e-10 + (x - 1.99) ** 2),
    lambda x, y: -0.5 * (x - 1.99) / ca.sqrt((x - 1.99) ** 2 + 1e-30),
    lambda x, y: -0.5 / (1 + ca.exp(-1e9 * (x - 1.99))),
    lambda x, y: -0.5 * ca.fmin(ca.fmax(1e12 * (x - 1.99), 0), 1),
    lambda x, y: -0.5 * ca.fmin(2 ** (1e9 * (x - 1.99)), 1),  # its switch overflows
    lambda x, y: where((x - 1.99) / ca.fabs(x - 1.99) > 0, -0.5, 0.0),
    lambda x, y: -0.5 * ca.fmod(2 * x, 3.98),
    lambda x, y: -1e-3 / ca.fabs(x - 1.99) ** 0.5,
)
"""Jumps, needles, poles near x = 1.99."""
