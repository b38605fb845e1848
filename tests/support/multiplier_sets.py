"""Stationarity of corners with linear data by enumeration of sign patterns, with scipy's linprog alone."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.optimize import linprog

from rmesh_nlp.mpcc import MPCC

PIECES = {"S": ((-1, -1),), "M": ((-1, -1), (0, 2), (2, 0)), "C": ((-1, -1), (1, 1))}
"""Signs of the two multipliers of a biactive pair: -1 (<= 0), 0 (= 0), 1 (>= 0), 2 (free)."""

LIMITS = {-1: (None, 0), 0: (0, 0), 1: (0, None), 2: (None, None)}
TOLERANCE = 1e-6


@dataclass(frozen=True)
class Corner:
    """At the origin: slope c, biactive pairs ``G x _|_ H x``, rows and bounds with the signs they allow.

    Attributes
    ----------
    c : (n,) array
    G, H : (pairs, n) arrays
    B : (rows, n) array
    row_signs, bound_signs : arrays of int
        -1 at a lower bound, 1 at an upper one, 2 at both, 0 at none.
    """

    c: np.ndarray
    G: np.ndarray
    H: np.ndarray
    B: np.ndarray
    row_signs: np.ndarray
    bound_signs: np.ndarray

    def mpcc(self) -> MPCC:
        """As a program."""
        x = ca.SX.sym("x", self.c.size)
        lbx, ubx = _bounds(self.bound_signs)
        lbg, ubg = _bounds(self.row_signs)
        g = self.B @ x if self.B.shape[0] else None
        rows = {"lbg": lbg, "ubg": ubg} if self.B.shape[0] else {}
        return MPCC(x, ca.dot(self.c, x), g, self.G @ x, self.H @ x, lbx=lbx, ubx=ubx, **rows)

    def has(self, pieces: Sequence[tuple[int, int]]) -> bool:
        """Whether there are multipliers with these signs on the pairs."""
        matrix = np.vstack([self.G, self.H, self.B, np.eye(self.c.size)]).T
        signs = [a for a, _ in pieces] + [b for _, b in pieces]
        bounds = [LIMITS[sign] for sign in (*signs, *self.row_signs, *self.bound_signs)]
        slack = TOLERANCE * max(1.0, float(np.max(np.abs(self.c))))
        answer = linprog(
            np.zeros(matrix.shape[1]),
            A_ub=np.vstack([matrix, -matrix]),
            b_ub=np.concatenate([slack - self.c, slack + self.c]),
            bounds=bounds,
        )
        return bool(answer.status == 0)

    def label(self) -> str:
        """The strongest label for which there are multipliers."""
        pairs = self.G.shape[0]
        for name, pieces in PIECES.items():
            if any(self.has(choice) for choice in itertools.product(pieces, repeat=pairs)):
                return name
        return "W" if self.has([(2, 2)] * pairs) else "none"


def _bounds(signs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Zero where a bound is active; else infinite, or far away for every second one."""
    far = np.where(np.arange(signs.size) % 2 == 0, np.inf, 3.0)
    return np.where(np.isin(signs, (-1, 2)), 0.0, -far), np.where(np.isin(signs, (1, 2)), 0.0, far)


def random_corner(random: np.random.Generator) -> Corner:
    """Small integers make coincidences: redundant rows, and multipliers that vanish."""
    pairs, rows = int(random.integers(1, 4)), int(random.integers(0, 4))
    n = pairs + int(random.integers(1, 4))
    G, H = (random.integers(-1, 2, (pairs, n)).astype(float) for _ in "GH")
    B = random.integers(-1, 2, (rows, n)).astype(float)
    row_signs, bound_signs = random.choice([-1, 0, 1, 2], rows), random.choice([-1, 0, 0, 0, 1], n)
    signs = np.concatenate([np.full(2 * pairs, 2), row_signs, bound_signs])
    size = random.integers(0, 3, signs.size).astype(float)
    multipliers = np.where(signs == 2, random.integers(-1, 3, signs.size), signs * size)
    c = -np.vstack([G, H, B, np.eye(n)]).T @ multipliers
    return Corner(c + (random.uniform() < 0.1) * random.normal(size=n), G, H, B, row_signs, bound_signs)
