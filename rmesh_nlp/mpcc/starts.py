"""Starts away from the given one, for rescues and for the best of several; what several starts reached."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import MPCCResult, Reached

_NEAR = 20.0  # bounds are near if they are no further apart than this, in units of 1 + |x0|
_SPREADS = (-1.0, 1.5)  # exponents of ten of the distance of random starts, in the same units
_SAME = 1e-4  # ends whose objectives differ by less, relative, are one


def moved_starts(mpcc: MPCC, x0: Array, seed: int) -> Iterator[Array]:
    """Seeded random starts without end, within the bounds.

    An unknown is uniform between its bounds where these are near each other, else normal around x0 and, in
    turn, around 0: a given start may itself be far away from everything.
    """
    lower, upper, random = np.asarray(mpcc.lbx), np.asarray(mpcc.ubx), np.random.default_rng(seed)
    for centre in itertools.cycle((x0, np.zeros_like(x0))):
        unit = 1 + np.abs(centre)
        near = (upper - lower) <= _NEAR * unit
        share = random.uniform(size=x0.size)
        spread = 10.0 ** random.uniform(*_SPREADS)
        around = np.clip(centre + spread * unit * random.normal(size=x0.size), lower, upper)
        inside = np.where(near, lower, 0.0) + share * np.where(near, upper - lower, 0.0)
        yield np.where(near, inside, around)


@dataclass(frozen=True, eq=False)
class MultiStart:
    """Results of all starts that were tried, in their order; the first is from the given start.

    ``joined[k]`` is the number of the start whose trajectory start k came upon; it has the same result. None:
    it was followed to its own end.
    """

    results: tuple[MPCCResult, ...]
    starts: tuple[Array, ...]
    seed: int
    joined: tuple[int | None, ...] = ()

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

    @property
    def reached(self) -> tuple[Reached, ...]:
        """What the starts ended at: objectives, the lowest first, then statuses without success."""
        ends: list[Reached] = []
        for r in sorted(self.results, key=lambda r: (not r.success, r.f if r.success else 0.0)):
            last = ends[-1] if ends else None
            if last is not None and last.status is r.status and _is_same(r, last.f):
                ends[-1] = Reached(last.f, last.status, last.starts + 1)
            else:
                ends.append(Reached(r.f if r.success else float("nan"), r.status, 1))
        return tuple(ends)

    def summary(self) -> MPCCResult:
        """The best result with what all starts reached; counts and seconds are sums over the starts."""
        own = [r for r, j in zip(self.results, self.joined, strict=True) if j is None]
        counts = {name: sum(r.counts[name] for r in own) for name in own[0].counts}
        seconds = {name: sum(r.seconds[name] for r in own) for name in own[0].seconds}
        return replace(self.best, reached=self.reached, counts=counts, seconds=seconds)

    def __str__(self) -> str:
        (low, high), n = self.spread, f"{sum(r.success for r in self.results)} of {len(self.results)}"
        return f"{n} starts succeeded, f from {low:.8g} to {high:.8g}; best: {self.best}"


def _is_same(result: MPCCResult, f: float) -> bool:
    return not result.success or abs(result.f - f) <= _SAME * (1 + abs(f))
