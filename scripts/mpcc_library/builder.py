"""Problems written as a modelling language does."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.reading import Problem


class Builder:
    """Collects unknowns, constraints and pairs one after the other, as a modelling language does."""

    def __init__(self) -> None:
        self._x: list[Any] = []
        self._lbx: list[float] = []
        self._ubx: list[float] = []
        self._x0: list[float] = []
        self._g: list[Any] = []
        self._lbg: list[float] = []
        self._ubg: list[float] = []
        self._G: list[Any] = []
        self._H: list[Any] = []

    def unknown(
        self, n: int = 1, lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf, start: ArrayLike = 0.0
    ) -> Any:
        """Return ``n`` new unknowns as a column."""
        x = ca.SX.sym(f"x{len(self._x)}", n)
        self._x.append(x)
        for store, value in ((self._lbx, lower), (self._ubx, upper), (self._x0, start)):
            store.extend(np.broadcast_to(np.asarray(value, dtype=float), n))
        return x

    def constrain(self, g: Any, lower: ArrayLike = 0.0, upper: ArrayLike = 0.0) -> None:
        """Add ``lower <= g <= upper``."""
        g = ca.vec(ca.SX(g))
        self._g.append(g)
        for store, value in ((self._lbg, lower), (self._ubg, upper)):
            store.extend(np.broadcast_to(np.asarray(value, dtype=float), g.numel()))

    def pair(self, G: Any, H: Any) -> None:
        """Add ``0 <= G _|_ H >= 0`` componentwise."""
        self._G.append(ca.vec(ca.SX(G)))
        self._H.append(ca.vec(ca.SX(H)))

    def done(self, name: str, f: Any) -> Problem:
        """Return the problem with objective ``f``."""
        mpcc = MPCC(
            self._x, f, self._g or None, self._G, self._H, lbx=self._lbx, ubx=self._ubx,
            lbg=np.array(self._lbg), ubg=np.array(self._ubg),
        )  # fmt: skip
        return Problem(name, mpcc, np.array(self._x0))
