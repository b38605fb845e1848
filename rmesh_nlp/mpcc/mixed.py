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
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from rmesh_nlp.mpcc.names import Symbolic, in_short

Member = tuple[Symbolic, float, float]
"""An expression with its bounds."""


def sides(pairs: Iterable[tuple[Member, Member]]) -> dict[str, list[Symbolic | float]]:
    """The pairs as keywords of ``MPCC.mixed``: G, H, and their bounds."""
    names, columns = ("G", "lbG", "ubG", "H", "lbH", "ubH"), [(*a, *b) for a, b in pairs]
    return {name: [column[k] for column in columns] for k, name in enumerate(names)}


@dataclass
class PlainPairs:
    """What mixed pairs become: pairs, rows, and new unknowns ``up``, ``down`` of ``source = up - down``."""

    kind: type[Symbolic]
    unknowns: list[Symbolic] = field(default_factory=list)
    sources: list[Symbolic] = field(default_factory=list)
    rows: list[Symbolic] = field(default_factory=list)
    G: list[Symbolic] = field(default_factory=list)
    H: list[Symbolic] = field(default_factory=list)

    def add(self, i: int, a: Symbolic, b: Symbolic, lg: float, ug: float, lh: float, uh: float) -> None:
        """Rewrite pair i; raises ValueError if its bounds make no complementarity."""
        match tuple(int(np.isfinite(bound)) for bound in (lg, ug, lh, uh)):
            case (0, 0, 1, 1):
                self._bounded(lh, b, uh, a)
            case (1, 1, 0, 0):
                self._bounded(lg, a, ug, b)
            case (0, 0, 0, 0):
                self.rows.append(a)
            case (g_low, g_high, h_low, h_high) if g_low + g_high == 1 and h_low + h_high == 1:
                self._pair(a - lg if g_low else ug - a, b - lh if h_low else uh - b)
            case _:
                raise ValueError(
                    f"pair {i} has the bounds {lg} <= G <= {ug}, {lh} <= H <= {uh}: exactly two of the "
                    "four must be finite (or none, for the equation G = 0); "
                    f"G is {in_short(a)}, H is {in_short(b)}"
                )

    def _pair(self, a: Symbolic, b: Symbolic) -> None:
        self.G.append(a)
        self.H.append(b)

    def _bounded(self, lower: float, value: Symbolic, upper: float, partner: Symbolic) -> None:
        """Add ``lower <= value <= upper _|_ partner``."""
        if lower == upper:
            self.rows.append(value - lower)
            return
        n = len(self.sources)
        up, down = self.kind.sym(f"up{n}"), self.kind.sym(f"down{n}")
        self.unknowns += [up, down]
        self.sources.append(partner)
        self.rows.append(partner - up + down)
        self._pair(up, value - lower)
        self._pair(down, upper - value)

    def completion(self, x: Symbolic, p: Symbolic) -> ca.Function | None:
        """``(x, p) -> `` the new unknowns at a start: ``max(source, 0)`` and ``max(-source, 0)``."""
        if not self.sources:
            return None
        values = [value for source in self.sources for value in (ca.fmax(source, 0), ca.fmax(-source, 0))]
        return ca.Function("completion", [x, p], [ca.densify(ca.vertcat(*values))])
