"""Mixed complementarity: bounds on either side of a pair, written as ordinary pairs.

Of the four bounds of a mixed pair exactly two are finite, as in AMPL's ``complements``.
One on each side is a shift or a reflection: ``G >= lbG _|_ H >= lbH`` becomes
``0 <= G - lbG _|_ H - lbH >= 0`` (upper bounds: ``ubG - G``, ``ubH - H``). Both on one side, say H::

    lbH <= H <= ubH  _|_  G      means  H = lbH and G >= 0,  or  H = ubH and G <= 0,  or between and G = 0.

It becomes ``G = up - down`` with two new unknowns, ``0 <= up _|_ H - lbH >= 0`` and
``0 <= down _|_ ubH - H >= 0``. ``lbH = ubH`` fixes H and leaves G free. A pair without any finite bound
(AMPL's free variable) is the equation ``G = 0``.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from rmesh_nlp.mpcc.names import in_short
from rmesh_nlp.optimize.nlp import Symbolic

Member = tuple[Symbolic, float, float]
"""An expression with its bounds."""


class PlainPairs(NamedTuple):
    """What mixed pairs become."""

    G: list[Symbolic]
    H: list[Symbolic]
    rows: list[Symbolic]
    """Expressions that vanish."""
    unknowns: list[Symbolic]
    """``up``, ``down`` of each pair with both bounds on one side."""
    values: list[Symbolic]
    """The other members of these pairs, ``up - down``."""


def plain_pairs(pairs: Iterable[tuple[Member, Member]], kind: type[Symbolic]) -> PlainPairs:
    """Rewrite mixed pairs; raises ValueError if the bounds of a pair make no complementarity."""
    plain = PlainPairs([], [], [], [], [])
    for i, (first, second) in enumerate(pairs):
        n_first, n_second = (int(np.isfinite(member[1:]).sum()) for member in (first, second))
        if n_first + n_second not in (0, 2):
            (a, lg, ug), (b, lh, uh) = first, second
            raise ValueError(
                f"pair {i} has the bounds {lg} <= G <= {ug}, {lh} <= H <= {uh}: exactly two of the "
                "four must be finite (or none, for the equation G = 0); "
                f"G is {in_short(a)}, H is {in_short(b)}"
            )
        (partner, *_), (value, lower, upper) = (second, first) if n_first == 2 else (first, second)
        if n_first == n_second == 1:
            plain.G.append(_room(*first))
            plain.H.append(_room(*second))
        elif n_first == n_second:
            plain.rows.append(partner)
        elif lower == upper:
            plain.rows.append(value - lower)
        else:
            n = len(plain.unknowns) // 2
            up, down = kind.sym(f"up{n}"), kind.sym(f"down{n}")
            plain.rows.append(partner - up + down)
            plain.G.extend([up, down])
            plain.H.extend([value - lower, upper - value])
            plain.unknowns.extend([up, down])
            plain.values.append(partner)
    return plain


def _room(value: Symbolic, lower: float, upper: float) -> Symbolic:
    """Distance from the bound that is finite."""
    return value - lower if np.isfinite(lower) else upper - value
