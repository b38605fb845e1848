"""Multi-start: the same compiled problem from seeded random starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import MPCCResult
from rmesh_nlp.mpcc.run import Progress
from rmesh_nlp.mpcc.solver import MPCCSolver


@dataclass(frozen=True, eq=False)
class MultiStart:
    """Results of all starts.

    Attributes
    ----------
    results : tuple of MPCCResult
        In the order of the starts; the first is from the given start.
    starts : tuple of arrays
    seed : int
    """

    results: tuple[MPCCResult, ...]
    starts: tuple[Array, ...]
    seed: int

    @property
    def best(self) -> MPCCResult:
        """The lowest successful result; if none succeeded, the most nearly feasible one."""
        return min(
            self.results,
            key=lambda r: (not r.success, r.f if r.success else r.constraint_violation + r.complementarity),
        )

    @property
    def spread(self) -> tuple[float, float]:
        """Lowest and highest objective of the successful results (NaN if there are none)."""
        values = [r.f for r in self.results if r.success]
        return (min(values), max(values)) if values else (float("nan"), float("nan"))

    def __str__(self) -> str:
        low, high = self.spread
        n = sum(r.success for r in self.results)
        return (
            f"{n} of {len(self.results)} starts succeeded, f from {low:.8g} to {high:.8g}; best: {self.best}"
        )


def starts(mpcc: MPCC, x0: ArrayLike, n: int, seed: int, reach: float = 1.0) -> tuple[Array, ...]:
    """Return ``x0`` and ``n - 1`` seeded starts: uniform between the bounds, where both are near enough, else
    normal around ``x0`` with standard deviation ``reach (1 + |x0|)``, clipped to the bounds.
    """  # noqa: D205
    centre = mpcc.start(x0)
    lower, upper = np.asarray(mpcc.lbx), np.asarray(mpcc.ubx)
    boxed = (upper - lower) <= 20 * reach * (1 + np.abs(centre))
    random = np.random.default_rng(seed)
    found = [centre]
    for _ in range(n - 1):
        share = random.uniform(size=centre.size)
        spread = reach * 10.0 ** random.uniform(-1, 1.5)
        around = np.clip(
            centre + spread * (1 + np.abs(centre)) * random.normal(size=centre.size), lower, upper
        )
        inside = np.where(boxed, lower, 0.0) + share * np.where(boxed, upper - lower, 0.0)
        found.append(np.where(boxed, inside, around))
    return tuple(found)


def multistart(
    mpcc: MPCC,
    x0: ArrayLike,
    *,
    n: int = 10,
    seed: int = 0,
    p: ArrayLike = (),
    options: Options | None = None,
    progress: Progress | bool = False,
    **changes: object,
) -> MultiStart:
    """Solve from ``x0`` and from ``n - 1`` seeded random starts around it.

    Parameters are those of :func:`rmesh_nlp.mpcc.solve`, and ``n`` and ``seed``: the same seed gives
    the same starts.
    """
    if n < 1:
        raise ValueError(f"n = {n} starts: at least 1 is needed")
    solver = MPCCSolver(mpcc, options, **changes)
    chosen = starts(mpcc, x0, n, seed)
    return MultiStart(tuple(solver(start, p=p, progress=progress) for start in chosen), chosen, seed)
