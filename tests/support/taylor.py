"""Rates of remainders and differences, for derivatives away from the mesh as given."""

from collections.abc import Callable
from typing import Any

import numpy as np

from rmesh_nlp.evaluation import Array


def taylor_order(function: Callable[[Array], Any], q: Array, d: Array, step: float = 1e-3) -> float:
    """Order of ``F(q + h d) - F(q) - h F'(q) d`` at a halved step: 2 if the gradient is right.

    ``function`` gives points with ``value`` and ``gradient``.
    """
    here = function(q)
    one, two = (abs(function(q + h * d).value - here.value - h * here.gradient @ d) for h in (step, step / 2))
    return float(np.log2(one / two))


def difference_order(gradient: Callable, product: Array, q: Array, d: Array, step: float = 1e-2) -> float:
    """Order at which central differences of a gradient converge to ``product``: 2 if that is ``F'' d``."""

    def error(h: float) -> float:
        difference = (gradient(q + h * d) - gradient(q - h * d)) / (2 * h)
        return float(np.max(np.abs(difference - product)))

    return float(np.log2(error(step) / error(step / 2)))
