"""Where the parts of a vector are: the unknowns, rows and pairs of all models by their names."""

from __future__ import annotations

from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", bound=np.generic)


class Numbering:
    """Parts of a vector one after the other: ``Numbering(q=3, u=5)["u"]`` is ``slice(3, 8)``."""

    def __init__(self, **sizes: int) -> None:
        self.sizes = sizes
        self._ends = np.cumsum([0, *sizes.values()]).tolist()
        self.places = dict(zip(sizes, (slice(*ends) for ends in pairwise(self._ends)), strict=True))

    @property
    def size(self) -> int:
        """Number of entries of all parts."""
        return self._ends[-1]

    def __getitem__(self, name: str) -> slice:
        return self.places[name]

    def split(self, values: NDArray[Scalar]) -> list[NDArray[Scalar]]:
        """The parts of a vector, or of the rows of a matrix."""
        return [values[place] for place in self.places.values()]
