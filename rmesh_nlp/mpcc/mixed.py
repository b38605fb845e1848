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

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, Index
from rmesh_nlp.mpcc.names import in_short
from rmesh_nlp.optimize.nlp import Symbolic


def plain_pairs(members: Symbolic, lower: Array, upper: Array) -> tuple[Symbolic, ...]:
    """Rewrite mixed pairs, ``lower <= vertcat(G, H) <= upper``.

    Returns
    -------
    G, H
        Plain pairs: those with a bound on each side, then those with both on one, all ``up``, all ``down``.
    up, down, values
        New unknowns, and the other members of these pairs, which are ``up - down``.
    rows
        Expressions that vanish.

    Raises
    ------
    ValueError
        If the bounds of a pair make no complementarity.
    """
    n = lower.size // 2
    count = (np.isfinite(lower) * 1 + np.isfinite(upper)).reshape(2, n)
    for i in np.flatnonzero(~np.isin(count.sum(axis=0), (0, 2)))[:1].tolist():
        raise ValueError(
            f"pair {i} has the bounds {lower[i]} <= G <= {upper[i]}, {lower[n + i]} <= H <= {upper[n + i]}: "
            "exactly two of the four must be finite (or none, for the equation G = 0); "
            f"G is {in_short(members[i])}, H is {in_short(members[n + i])}"
        )
    bounded = np.arange(n) + np.where(count[0] == 2, 0, n)  # the member with both bounds, or H
    other, is_equal = (bounded + n) % (2 * n), lower[bounded] == upper[bounded]
    is_one, is_free = (np.all(count == k, axis=0) for k in (1, 0))

    def of(entries: Index) -> Symbolic:
        return ca.reshape(members[entries.tolist()], -1, 1)  # one taken at no place is a row

    def room(entries: Index) -> Symbolic:
        """Distance from the bound that is finite, of two the lower."""
        is_low = np.isfinite(lower[entries])
        sign, bound = np.where(is_low, 1.0, -1.0), np.where(is_low, lower[entries], upper[entries])
        return ca.DM(sign) * (of(entries) - ca.DM(bound))

    is_two = ~(is_one | is_free | is_equal)
    first, two, values = np.flatnonzero(is_one), bounded[is_two], of(other[is_two])
    up, down = (type(members).sym(name, two.size) for name in ("up", "down"))
    G = ca.vertcat(room(first), up, down)
    H = ca.vertcat(room(first + n), room(two), ca.DM(upper[two]) - of(two))
    return G, H, up, down, values, ca.vertcat(of(other[is_free]), room(bounded[is_equal]))
