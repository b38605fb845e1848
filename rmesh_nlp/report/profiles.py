"""Profiles of formulations over many problems: performance, data and quality.

Performance profiles are those of Dolan and Moré, Math. Program. 91 (2002): the share of problems that a
formulation solves at a cost within a factor tau of the cheapest. Data profiles are those of Moré and Wild,
SIAM J. Optim. 20 (2009): the share of problems of which it reaches a part of the best gain at a cost of
at most kappa contact solves. A failure is an infinite cost, never a missing problem.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array

SAME = 1e-9
"""Ratios that agree to this are one: costs of two clocks' ticks are ties."""


@dataclass(frozen=True)
class Profile:
    """A step function: the share of problems done at a value of at most x.

    Attributes
    ----------
    at : (steps,) array
        Where it rises, increasing.
    share : (steps,) array
        Its value from there on, in [0, 1].
    """

    at: Array
    share: Array

    def __call__(self, x: ArrayLike) -> Array:
        """The share at ``x``."""
        place = np.searchsorted(self.at, np.asarray(x, dtype=float) * (1 + SAME), side="right")
        return np.concatenate([[0.0], self.share])[place]


def data_profiles(costs: Mapping[str, ArrayLike]) -> dict[str, Profile]:
    """Moré and Wild's profiles over the cost itself, in contact solves.

    Parameters
    ----------
    costs : mapping from formulations to (problems,) arrays
        Cost at which a part of the best gain was reached, see
        :func:`rmesh_nlp.report.histories.cost_of_gain`; infinite if it never was.
    """
    return {name: _profile(row) for name, row in zip(costs, _table(costs), strict=True)}


def performance_profiles(costs: Mapping[str, ArrayLike]) -> dict[str, Profile]:
    """Dolan and Moré's profiles over the ratio to the cheapest formulation.

    Parameters
    ----------
    costs : mapping from formulations to (problems,) arrays
        Infinite where a formulation failed. Problems that every formulation failed count, as failures of all.
    """
    table = _table(costs)
    best = np.min(table, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratios = np.where(best > 0, table / best, np.where(table == 0, 1.0, np.inf))
    return {name: _profile(row) for name, row in zip(costs, _failing(ratios, table), strict=True)}


def quality_profiles(energies: Mapping[str, ArrayLike], initial: ArrayLike) -> dict[str, Profile]:
    """Profiles over the part of the best gain that a formulation's final energy misses.

    Parameters
    ----------
    energies : mapping from formulations to (problems,) arrays
        Final energies, infinite where a formulation failed.
    initial : (problems,) array
        Energies of the given meshes. Where no formulation gains anything, all that did not fail miss nothing.
    """
    table = np.array([np.asarray(row, dtype=float) for row in energies.values()])
    best = np.min(table, axis=0)
    gain = np.asarray(initial, dtype=float) - best
    with np.errstate(invalid="ignore", divide="ignore"):
        missed = np.where(gain > 0, (table - best) / gain, np.where(table <= best, 0.0, np.inf))
    return {name: _profile(row) for name, row in zip(energies, _failing(missed, table), strict=True)}


def _table(costs: Mapping[str, ArrayLike]) -> Array:
    table = np.array([np.asarray(row, dtype=float) for row in costs.values()])
    if table.ndim != 2:
        raise ValueError("every formulation needs a cost for every problem")
    if np.any(table[np.isfinite(table)] < 0) or np.any(np.isnan(table)):
        raise ValueError("costs must not be negative; a failure is infinite")
    return table


def _failing(values: Array, table: Array) -> Array:
    """The values, infinite where the table says that a formulation failed."""
    return np.where(np.isfinite(table), values, np.inf)


def _profile(values: Array) -> Profile:
    """The distribution of values, those that are infinite never reached."""
    at, counts = np.unique(values[np.isfinite(values)], return_counts=True)
    return Profile(at, np.cumsum(counts) / max(values.size, 1))
