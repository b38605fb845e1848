"""Units in which Ipopt is given an outer problem, as its tolerances and barriers are absolute."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array, magnitude
from rmesh_nlp.models.reduced_model import ReducedPoint

ORDINARY = (1e-4, 1e4)
"""Sizes of displacements that Ipopt is given as they are; others are measured in the largest of them."""


def pull(gradient: Array) -> float:
    """The unit of the objective in which a barrier of order one suits the outer variables.

    Three times the mean of the gradient in the outer variables; 1 where nothing pulls. For the energy it
    falls like the gain per node, by a factor near 20 with every halving of the mesh size.
    """
    return 3 * float(np.mean(np.abs(gradient))) if np.any(gradient) else 1.0


def length(contact: ReducedPoint) -> float:
    """The largest displacement if it is far from one; else 1."""
    largest = magnitude(contact.equilibrium.u)
    return 1.0 if largest == 0 or ORDINARY[0] <= largest <= ORDINARY[1] else largest
