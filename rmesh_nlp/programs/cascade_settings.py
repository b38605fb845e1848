"""Settings of the cascade of meshes."""

from __future__ import annotations

from dataclasses import dataclass

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.programs.regularisation import regularised, weights
from rmesh_nlp.settings import Settings, check_positive


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

    regularisation: float = 0.003
    distortion: str = "shape-size"
    schedules: tuple[tuple[float, ...], ...] = ((1.0, 0.1),)
    coarsest: int = 60
    thorough: int = 1200
    end: float = 1e-3
    continued: float = 1e-2
    iterations: int = 60
    brief: int = 8
    brief_unnested: int = 20
    stationary: int = 1200
    finish: int = 120
    most: int = 200

    def __post_init__(self) -> None:
        check_positive(
            coarsest=self.coarsest,
            thorough=self.thorough,
            end=self.end,
            continued=self.continued,
            iterations=self.iterations,
            brief=self.brief,
            brief_unnested=self.brief_unnested,
            finish=self.finish,
            most=self.most,
        )
        regularised(1.0, self.regularisation, self.distortion)
        if not self.regularisation > 0:
            raise BadInputError("the cascade needs a regularisation above 0: it keeps the elements valid")
        for schedule in self.schedules:
            weights((*schedule, self.regularisation), "a schedule of the cascade")
