"""Settings of the cascade of meshes."""

from __future__ import annotations

from dataclasses import dataclass

from rmesh_nlp.programs.regularisation import regularised, weights
from rmesh_nlp.settings import Count, Limit, Positive, Settings


@dataclass(frozen=True)
class CascadeSettings(Settings):
    """Settings of the cascade, chosen on Example 6.1 with 8 to 128 squares a side.

    docs/notes/large_moves.md has what other values gave, also on other problems.

    Attributes
    ----------
    regularisation : float
        Final weight of the distortion, relative to the estimated error of the energy.
    distortion : str
        See :mod:`rmesh_nlp.fem.distortion`.
    schedules : tuple of tuples of float
        Weights before the final one on the coarsest mesh, relative to the error too; the best end counts.
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
    stationary : int
        Largest number of nodes of a given mesh on which ``auto`` goes on to a stationary point.
    finish : int
        Limit of the iterations of that.
    most : int
        Contact solves of all meshes together after which ``auto`` does not go on to a stationary point.
    """

    regularisation: Positive = 0.003
    distortion: str = "shape-size"
    schedules: tuple[tuple[float, ...], ...] = ((1.0, 0.1),)
    coarsest: Count = 60
    thorough: Count = 1200
    end: Positive = 1e-3
    continued: Positive = 1e-2
    iterations: Count = 60
    brief: Count = 8
    brief_unnested: Count = 20
    stationary: Limit = 1200
    finish: Count = 120
    most: Count = 200

    def __post_init__(self) -> None:
        super().__post_init__()
        regularised(1.0, self.regularisation, self.distortion)
        for schedule in self.schedules:
            weights((*schedule, self.regularisation), "a schedule of the cascade")
