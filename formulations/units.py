"""Units in which Ipopt is given an outer problem, as its tolerances and barriers are absolute."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.reduced_model import ReducedPoint

ORDINARY = (1e-4, 1e4)
"""Sizes of displacements that Ipopt is given as they are; others are measured in the largest of them."""


def pull(gradient: Array) -> float:
    """The unit of the objective in which a barrier of order one suits the outer variables.

    Three times the mean of the gradient in the outer variables; 1 where nothing pulls. For the energy it
    falls like the gain per node, by a factor near 20 with every halving of the mesh size.
    """
    return 3 * float(np.mean(np.abs(gradient))) if np.any(gradient) else 1.0


def half_energy(point: ReducedPoint) -> float:
    """Half the size of the energies in a contact solution, which may cancel in their sum; 1 where all vanish.

    Of 1, 2, 5 and 10 parts of the energy two gave the least iterations and energies on the examples and the
    gallery.
    """
    u = point.equilibrium.u
    return 0.5 * max(abs(point.value), 0.5 * float(u @ (point.system.stiffness @ u))) or 1.0


def length(contact: ReducedPoint) -> float:
    """The largest displacement if it is far from one; else 1."""
    largest = float(np.max(np.abs(contact.equilibrium.u)))
    return 1.0 if largest == 0 or ORDINARY[0] <= largest <= ORDINARY[1] else largest
