"""Units in which Ipopt is given an outer problem, as its tolerances are absolute, and its options."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array, magnitude
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.optimize.solver import LEAST_SHIFTS, PluginOptions

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


COMMON: PluginOptions = {
    "nlp_scaling_method": "none",
    "mu_strategy": "monotone",
    # METIS: the KKT matrix of equilibrium, outer variables and displacements fills in five times
    # less than with the ordering that MUMPS takes of itself
    "mumps_pivot_order": 5,
    **LEAST_SHIFTS,
}
"""Options for the KKT model."""

TIGHT = 1e-10
"""Tolerance in an exact finish, the objective in units of its mean gradient by outer variables."""

CENTRED: PluginOptions = {"mu_init": 2.0, "bound_mult_init_method": "mu-based"}
"""Options where nodes have move limits alone: Ipopt starts in the middle of them, and the nodes choose their
corners as the barrier falls. Without these and least shifts `joint` takes 48, 48, 105, 132 iterations on 6.1
with 8, 16, 24, 32 squares a side, with them 35, 48, 61, 79, and ends no higher."""


def exact(scaling: float, barrier: float) -> PluginOptions:
    """Options of an exact finish of the KKT model, with the factor of the objective and the first barrier."""
    own = {"obj_scaling_factor": scaling, "mu_init": barrier, "tol": TIGHT, "acceptable_tol": 1e3 * TIGHT}
    return {**COMMON, **own}


def pushed(distance: float) -> PluginOptions:
    """Options that push a start off its bounds by so much at least."""
    names = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
    return dict.fromkeys(names, distance)
