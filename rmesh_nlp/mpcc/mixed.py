"""Mixed complementarity: bounds on either side of a pair, written as ordinary pairs.

For every pair exactly two of the four bounds ``lbG, ubG, lbH, ubH`` are finite, as in AMPL's
``complements``. One on each side::

    G >= lbG  _|_  H >= lbH      becomes  0 <= G - lbG  _|_  H - lbH >= 0   (upper bounds: ubG - G, ubH - H)

Both on one side, say H, the other free::

    lbH <= H <= ubH  _|_  G      means  H = lbH and G >= 0,  or  H = ubH and G <= 0,  or between and G = 0.

It becomes ``G = up - down`` with two new unknowns, ``0 <= up _|_ H - lbH >= 0`` and
``0 <= down _|_ ubH - H >= 0``. A bound met by its partner (``lbH = ubH``) fixes H and leaves G free. A pair
with no finite bound on H at all (AMPL's free variable) is the equation ``G = 0``, if G has none either.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array


@dataclass
class Parts:
    """What mixed pairs become: new unknowns (``up``, ``down`` of ``source = up - down``), rows and pairs."""

    kind: Any
    unknowns: list[Any] = field(default_factory=list)
    sources: list[Any] = field(default_factory=list)
    rows: list[Any] = field(default_factory=list)
    firsts: list[Any] = field(default_factory=list)
    seconds: list[Any] = field(default_factory=list)

    def pair(self, a: Any, b: Any) -> None:
        """Add ``0 <= a _|_ b >= 0``."""
        self.firsts.append(a)
        self.seconds.append(b)

    def boxed(self, lower: float, value: Any, upper: float, partner: Any) -> None:
        """Add ``lower <= value <= upper _|_ partner``."""
        if lower == upper:
            self.rows.append(value - lower)
            return
        n = len(self.sources)
        up, down = self.kind.sym(f"up{n}"), self.kind.sym(f"down{n}")
        self.unknowns += [up, down]
        self.sources.append(partner)
        self.rows.append(partner - up + down)
        self.pair(up, value - lower)
        self.pair(down, upper - value)


def split(kind: Any, G: Any, H: Any, bounds: tuple[Array, Array, Array, Array]) -> Parts:
    """Rewrite the pairs; raises ValueError for a pair whose bounds make no complementarity."""
    parts = Parts(kind)
    for i, (lg, ug, lh, uh) in enumerate(zip(*bounds, strict=True)):
        a, b = G[i], H[i]
        count = tuple(int(np.isfinite(bound)) for bound in (lg, ug, lh, uh))
        match count:
            case (0, 0, 1, 1):
                parts.boxed(lh, b, uh, a)
            case (1, 1, 0, 0):
                parts.boxed(lg, a, ug, b)
            case (0, 0, 0, 0):
                parts.rows.append(a)
            case (g_low, g_high, h_low, h_high) if g_low + g_high == 1 and h_low + h_high == 1:
                parts.pair(a - lg if g_low else ug - a, b - lh if h_low else uh - b)
            case _:
                raise ValueError(
                    f"pair {i} has the bounds {lg} <= G <= {ug}, {lh} <= H <= {uh}: exactly two of the "
                    "four must be finite (or none, for the equation G = 0)"
                )
    return parts


def pair_bound(name: str, value: ArrayLike, n: int) -> Array:
    """A bound of the pairs as an array of length ``n``."""
    array = np.asarray(value, dtype=float)
    array = np.full(n, float(array)) if array.ndim == 0 else array.ravel()
    if array.size != n:
        raise ValueError(f"{name} has length {array.size}, expected {n}")
    if np.any(np.isnan(array)):
        raise ValueError(f"{name}[{int(np.flatnonzero(np.isnan(array))[0])}] is NaN")
    return array


def completion(x: Any, p: Any, parts: Parts) -> ca.Function | None:
    """``(x, p) -> `` values of the new unknowns at a user's start: ``max(G, 0)`` and ``max(-G, 0)``."""
    if not parts.sources:
        return None
    values = [value for source in parts.sources for value in (ca.fmax(source, 0), ca.fmax(-source, 0))]
    return ca.Function("completion", [x, p], [ca.densify(ca.vertcat(*values))])
