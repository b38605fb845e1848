"""How ``mpcc`` runs the homotopy, and Ipopt in it; docs/notes/mpcc-speed.md has what chose the numbers.

The settings were chosen on Example 6.1 with 5 to 26, and Examples 6.2 and 6.3 with 8 to 20 squares a
side, other than the sizes that are reported, and on 16 random problems; the first barrier for the energy
and how it falls on 6.1 with 32 squares and on the paper's grids, and 30 other random problems confirmed
them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

OPTIONS: Mapping[str, Any] = {
    "t0": 1e-2,
    "factor": 0.1,
    "t_final": 1e-9,
    "crossover": 1e-2,
    "warm_duals": True,
    # Hundreds of boxes are weakly active at the end: an active-set Newton method does not find which.
    "newton_finish": False,
}
"""Options of :class:`rmesh_nlp.mpcc.Options` for mesh problems. t is in units of the largest displacement
on the given mesh times its largest nodal load."""

PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
"""Ipopt options that push a start off its bounds."""

BARRIER_ENERGY, BARRIER = 2.0, 0.1
"""Ipopt's first barrier: in units of the pull for the energy, as in ``joint``, in units of the objective for
others."""

BARRIER_WITHOUT_BOXES = 0.03
"""That for the energy where moves have no boxes: there is no middle of them to begin in. Over 56 random
problems without boxes it takes 4,162 iterations, the other one 4,709."""

SLOWLY: Mapping[str, Any] = {"mu_linear_decrease_factor": 0.5, "mu_superlinear_decrease_power": 1.2}
"""How Ipopt's barrier falls in the first relaxation of the energy; 0.2 and 1.5 are Ipopt's own.

The moves choose their corners while it falls. Slowly, the path of ``mpcc`` keeps near the central one, which
is that of ``joint``, and ends in the same minima: 0.45 % of the gain lower on 6.1 with 32 squares a side. It
costs no iterations in the sum."""

LOOSE, BETWEEN, TIGHT = 1e-4, 1e-8, 1e-10
"""Ipopt's tolerance in the first relaxation, in the later ones, in the exact finish."""

TIGHT_OTHERS = 1e-12
"""That of the exact finish for objectives other than the energy, whose gradient is small in their own unit.

1e-10 left first-order residuals of 2e-6 to 7e-6 on 6.1 with 6 and 10 squares (error-l2, error-h1), 1e-12
less than 1e-7, for one or two iterations more."""


FACTOR_OTHERS = 0.01
"""By how much t falls from stage to stage for objectives other than the energy.

There the relaxed solution moves with t, so an exact finish after 1e-2 and 1e-3 starts far from its end.
With 0.1 seven solves took 392 iterations, with 0.01 310, to the same ends (error-l2 on 6.1 with 5, 6, 10
and 12 squares, error-h1 with 6 and 10, energy+0.1*quality on 6.2 with 8 x 4)."""


def other_options() -> dict[str, Any]:
    """Options of the homotopy for objectives other than the energy, on top of ``OPTIONS``."""
    return {**ipopt_options(1.0, BARRIER, TIGHT_OTHERS), "factor": FACTOR_OTHERS}


def energy_options(scaling: float, boxed: bool) -> dict[str, dict[str, Any]]:
    """Those of :func:`ipopt_options` for the energy, ``boxed`` where all moves have boxes."""
    if not boxed:
        return ipopt_options(scaling, BARRIER_WITHOUT_BOXES)
    options = ipopt_options(scaling, BARRIER_ENERGY)
    return {**options, "ipopt_relaxed": {**options["ipopt_relaxed"], **SLOWLY}}


def ipopt_options(scaling: float, barrier: float, tight: float = TIGHT) -> dict[str, dict[str, Any]]:
    """Ipopt's options by stage: the first relaxation, those after it, the exact finish.

    Each stage begins with the multipliers and about the barrier that the one before ended with, so
    that Ipopt goes on and does not centre anew.

    Parameters
    ----------
    scaling : float
        Factor of the objective. For the energy it brings the mean gradient in the moves to a third
        (:func:`formulations.joint.pull`): Ipopt's barrier and tolerances are absolute.
    barrier : float
    tight : float
        Tolerance of the exact finish.
    """
    common = {
        "nlp_scaling_method": "none",
        "obj_scaling_factor": scaling,
        # METIS: the KKT matrix of equilibrium, moves and displacements fills in five times less than
        # with the ordering that MUMPS takes of itself
        "mumps_pivot_order": 5,
        # the least shift of an indefinite Hessian within a factor 1.5, as in joint
        "perturb_dec_fact": 0.2,
        "perturb_inc_fact": 1.5,
    }
    first = {"mu_init": barrier, "bound_mult_init_method": "mu-based", "tol": LOOSE}
    return {
        "ipopt_relaxed": {**common, "mu_strategy": "monotone", **first},
        "ipopt_warm": {"mu_strategy": "monotone", "mu_init": LOOSE / 100, "tol": BETWEEN},
        "ipopt_exact": {
            **common,
            "mu_strategy": "monotone",
            "mu_init": tight,
            "tol": tight,
            # where rounding stops it before, this will do
            "acceptable_tol": 1e-7,
        },
    }


AFTER: Mapping[str, Any] = {"t0": 1e-9, "t_final": 1e-9}
"""Options after another program: only the relaxation at the final t, and the exact finish."""

BARRIER_AFTER = 1e-10
"""Ipopt's barrier at the end of the energy program: its tolerance there."""


def after_energy(scaling: float) -> dict[str, Any]:
    """Options from the minimiser of the energy program, or another formulation's, on.

    With the objective scaled and the barrier left about where that program left them, each
    slack times its multiplier is still the barrier: Ipopt goes on from there, as if it had been
    given the multipliers.
    """
    ipopt = {
        "tol": 1e-8,
        "obj_scaling_factor": scaling,
        "bound_mult_init_method": "mu-based",
        "mu_strategy": "monotone",
        "mu_init": BARRIER_AFTER,
        **dict.fromkeys(PUSHES, 1e-13),
    }
    # many boxes are weakly active: an interior point meets those only to the root of its tolerance
    exact = {**ipopt, "tol": 1e-11, "acceptable_tol": 1e-7}
    return {**AFTER, "ipopt_relaxed": ipopt, "ipopt_exact": exact}
