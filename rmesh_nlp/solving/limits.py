"""When a solve ends that has not converged."""

from __future__ import annotations

from dataclasses import dataclass

from rmesh_nlp.settings import Limit, Seconds, Settings

TOLERANCE = 1e-6
"""Default of ``tolerance``: the largest first-order residual of a point that is called stationary."""


@dataclass(frozen=True)
class Limits(Settings):
    """Limits of one solve, after which its best valid mesh is the solution.

    Attributes
    ----------
    seconds : float
        Of building and solving together, looked at after each iteration.
    iterations : int, optional
        Over everything that a formulation runs.
    """

    seconds: Seconds = 600.0
    iterations: Limit | None = None
