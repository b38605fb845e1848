"""Families of generated MPCCs, seeded and of any size. None of them chose a default option.

>>> FAMILIES["bouncing"].make(20, 0).name
'bouncing-20-0'
"""

from mpcc_library.equilibria import cournot, markets, tolls
from mpcc_library.instance import Builder, Family, Instance
from mpcc_library.random_programs import lpec
from mpcc_library.switched import bouncing, hysteresis

FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        Family("lpec", lpec, (4, 10, 30, 100), "random linear programs over linear pairs"),
        Family("bouncing", bouncing, (10, 30, 100, 300), "a point that falls onto a table"),
        Family("hysteresis", hysteresis, (10, 30, 100, 300), "the play operator"),
        Family("cournot", cournot, (4, 10, 30, 100), "a leader among producers"),
        Family("markets", markets, (2, 5, 15, 60), "taxes on competing firms"),
        Family("tolls", tolls, (3, 6, 12, 40), "tolls on a network in equilibrium"),
    )
}

__all__ = ["FAMILIES", "Builder", "Family", "Instance"]
