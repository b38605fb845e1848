"""Orders of displacements, as parameters of tests that are not quick at order 2."""

from __future__ import annotations

import pytest

ORDERS = (1, pytest.param(2, marks=pytest.mark.slow))
