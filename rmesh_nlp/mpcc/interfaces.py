"""Solves from many starts."""

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
    """Results of all starts, in their order; the first is from the given start."""

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
        values = [r.f for r in self.results if r.success] or [float("nan")]
        return min(values), max(values)

    def __str__(self) -> str:
        (low, high), n = self.spread, f"{sum(r.success for r in self.results)} of {len(self.results)}"
        return f"{n} starts succeeded, f from {low:.8g} to {high:.8g}; best: {self.best}"


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

    Starts are uniform between the bounds where both are near enough, else normal around ``x0``, clipped to
    the bounds. Parameters are those of :func:`rmesh_nlp.mpcc.solve`, and ``n`` and ``seed``: the same
    seed gives the same starts.
    """
    if n < 1:
        raise ValueError(f"n = {n} starts: at least 1 is needed")
    solver = MPCCSolver(mpcc, options, **changes)
    centre = mpcc.start(x0, p)
    lower, upper, unit = np.asarray(mpcc.lbx), np.asarray(mpcc.ubx), 1 + np.abs(centre)
    near = (upper - lower) <= 20 * unit
    random = np.random.default_rng(seed)
    starts = [centre]
    for _ in range(n - 1):
        share = random.uniform(size=centre.size)
        spread = 10.0 ** random.uniform(-1, 1.5)
        around = np.clip(centre + spread * unit * random.normal(size=centre.size), lower, upper)
        inside = np.where(near, lower, 0.0) + share * np.where(near, upper - lower, 0.0)
        starts.append(np.where(near, inside, around))
    return MultiStart(tuple(solver(start, p=p, progress=progress) for start in starts), tuple(starts), seed)
