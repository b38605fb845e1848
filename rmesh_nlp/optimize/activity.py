"""What counts as active: every tolerance of it, with the reason for its size.

Distances have no unit: outer variables are parts of their move limits, validity rows parts of an element's
area on the given mesh, gaps and forces parts of the largest displacement and of the loads. Two tolerances
are needed because descents and active sets put a point onto a bound, and interior points near it.
"""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array, Mask

ZERO = 1e-6
"""Distance below which a variable is at its bound, and a member of a complementarity pair is zero.

Descents put variables onto their bounds exactly, and active sets put gaps, slips and forces to zero exactly:
only rounding must fit in between."""

BOUND_OF_AN_NLP = 1e-5
"""Distance, relative to ``1 + |bound|``, at which an interior-point method may leave an active bound or row.

It stops with multiplier times distance near 1e-11, the tightest barrier of :mod:`rmesh_nlp.mpcc`: further
away than 1e-5 the multiplier is below 1e-6 and negligible. Validity rows with a smaller slack may have a
multiplier. Whether the two agree is part of the first-order residual."""


def is_inside(x: Array, lower: Array, upper: Array) -> Mask:
    """Variables that are off their bounds."""
    return (x - lower > ZERO) & (upper - x > ZERO)


def both_vanish(first: Array, second: Array) -> Mask:
    """Pairs at which strict complementarity fails: neither member has a sign to tell it."""
    return np.maximum(np.abs(first), np.abs(second)) < ZERO
