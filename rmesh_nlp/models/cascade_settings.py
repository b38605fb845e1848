"""Settings of the cascade of meshes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.models.regularisation import regularised, weights
from rmesh_nlp.settings import Count, Limit, Positive, Settings

Schedules = tuple[tuple[float, ...], ...]
"""Weights before the final one, schedule by schedule."""


@dataclass(frozen=True)
class CascadeSettings(Settings):
    """Settings of the cascade, chosen on Example 6.1 with 8 to 128 squares a side.

    The ``schedules`` were chosen on the L-shape, the wedge, Example 6.3 and the free boundary as well.
    docs/notes/large_moves.md has what other values gave, also on other problems.

    Attributes
    ----------
    regularisation : float
        Final weight of the distortion, relative to the estimated error of the energy.
    distortion : str
        See :mod:`rmesh_nlp.fem.distortion`.
    schedules : tuple of tuples of float
        Weights before the final one on the coarsest mesh, relative to the error too; the best end counts.
    cheap : float
        How many times the nodes of the coarsest mesh the finest one must have for more than the first of them
        to be tried.
    coarsest : int
        Least number of nodes of the coarsest mesh.
    thorough : int
        Largest number of nodes of a mesh, short of the finest, that is solved to the end.
    end : float
        A thorough descent ends where the model predicts less than this part of the gain; ...
    continued : float
        ... at the weights before the final one, less than this part.
    iterations : int
        Limit of a thorough descent.
    brief, brief_unnested : int
        Iterations on the other meshes, where they are uniform refinements of the next coarser one
        and where they are not: a map is then prolonged less well.
    growth : float
        Factor of these iterations from a mesh to the next coarser one. A coarser mesh costs a quarter per
        iteration: with 2 all meshes together cost about twice what the finest does.
    stationary : int
        Largest number of nodes of a given mesh on which ``auto`` goes on to a stationary point.
    finish : int
        Limit of the iterations of that.
    most : int
        Contact solves of all meshes together after which ``auto`` does not go on to a stationary point.
    """

    regularisation: Positive = 0.003
    distortion: str = "shape-size"
    schedules: Schedules = ((1.0, 0.1), (1.0, 0.1, 0.01), (0.1,), (0.1, 0.01))
    cheap: Positive = 40.0
    coarsest: Count = 60
    thorough: Count = 1200
    end: Positive = 3e-4
    continued: Positive = 1e-2
    iterations: Count = 60
    brief: Count = 10
    brief_unnested: Count = 20
    growth: Positive = 2.0
    stationary: Limit = 1200
    finish: Count = 120
    most: Count = 200

    def __post_init__(self) -> None:
        super().__post_init__()
        regularised(1.0, self.regularisation, self.distortion)
        kinds = (tuple, list)
        if not (isinstance(self.schedules, kinds) and all(isinstance(one, kinds) for one in self.schedules)):
            raise BadInputError(f"schedules must be lists of weights, got {self.schedules!r}")
        for schedule in self.schedules:
            weights((*schedule, self.regularisation), "a schedule of the cascade")

    def starts(self, coarsest: int, finest: int) -> Schedules:
        """The schedules that are tried on a coarsest mesh, by the nodes of both."""
        return self.schedules if finest >= self.cheap * coarsest else self.schedules[:1]

    def limit(self, is_brief: bool, is_nested: bool, above: int) -> int:
        """Largest number of iterations on a mesh with ``above`` finer ones."""
        if not is_brief:
            return self.iterations
        first = self.brief if is_nested else self.brief_unnested
        return min(math.ceil(first * self.growth**above), self.iterations)
