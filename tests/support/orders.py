"""Orders of displacements and other parameters of tests that are quick with some of them alone."""

from collections.abc import Iterable
from typing import Any

import pytest

ORDERS = (1, pytest.param(2, marks=pytest.mark.slow))


def slow_but(names: Iterable[str], *quick: str) -> list[Any]:
    """Names as parameters, those that are not among the ``quick`` ones slow."""
    return [pytest.param(name, marks=() if name in quick else pytest.mark.slow) for name in names]
