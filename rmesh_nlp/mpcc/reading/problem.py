"""A problem read from a file."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.problem import MPCC


@dataclass(frozen=True, eq=False)
class Problem:
    """What :func:`rmesh_nlp.mpcc.read` returns.

    Attributes
    ----------
    name : str
    mpcc : MPCC
    x0 : array
        Start, of the file's own unknowns; ``mpcc.start`` completes it.
    p0 : array
        Values of the parameters.
    sign : float
        -1 if the file maximises: ``mpcc.f`` is then minus its objective.
    target : float
        The best known value, where there is one; else NaN.
    """

    name: str
    mpcc: MPCC
    x0: Array
    p0: Array = field(default_factory=lambda: np.zeros(0))
    sign: float = 1.0
    target: float = float("nan")
