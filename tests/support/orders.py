"""Orders of displacements, as parameters of tests that are not quick at order 2."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

ORDERS = (1, pytest.param(2, marks=pytest.mark.slow))


QUICK = ("6.3, order 2", "two obstacles at a node, order 2")
"""Problems of order 2 that quick tests have; with all others they are slow."""


def slow_but(names: Iterable[str], quick: tuple[str, ...] = QUICK) -> list[Any]:
    """Names as parameters, those of order 2 that are not among the ``quick`` ones slow."""
    return [
        pytest.param(name, marks=() if name in quick or "order 2" not in name else pytest.mark.slow)
        for name in names
    ]
