"""Families of generated MPCCs, seeded and of any size. None of them chose a default option.

>>> make, sizes = FAMILIES["bouncing"]
>>> make(20, 0).name
'bouncing-20-0'
"""

from collections.abc import Callable

from mpcc_library.equilibria import cournot, markets, tolls
from mpcc_library.random_programs import lpec
from mpcc_library.switched import bouncing, hysteresis

from rmesh_nlp.mpcc.reading import Problem

FAMILIES: dict[str, tuple[Callable[[int, int], Problem], tuple[int, ...]]] = {
    "lpec": (lpec, (4, 10, 30, 100)),
    "bouncing": (bouncing, (10, 30, 100, 300)),
    "hysteresis": (hysteresis, (10, 30, 100, 300)),
    "cournot": (cournot, (4, 10, 30, 100)),
    "markets": (markets, (2, 5, 15, 60)),
    "tolls": (tolls, (3, 6, 12, 40)),
}
"""Makers, of a size and a seed, and sizes from tiny to a few thousand unknowns."""
