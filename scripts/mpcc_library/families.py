"""Families of generated MPCCs: seeded, of any size, to choose settings on and to measure with.

>>> FAMILIES["bouncing"].make(20, 0).name
'bouncing-20-0'
"""

from mpcc_library.equilibria import cournot, markets, tolls
from mpcc_library.instance import Builder, Family, Instance
from mpcc_library.random_programs import bilevel, lpec, qpec
from mpcc_library.switched import bouncing, friction, hysteresis, switch_detection

FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        Family("qpec", qpec, (4, 10, 30, 100), True, "random quadratic programs over linear pairs"),
        Family("bilevel", bilevel, (4, 10, 30, 100), True, "leaders over quadratic lower levels"),
        Family("switch-detection", switch_detection, (3, 10, 30), True, "steps that end at switches"),
        Family("lpec", lpec, (4, 10, 30, 100), False, "random linear programs over linear pairs"),
        Family("bouncing", bouncing, (10, 30, 100, 300), False, "a point that falls onto a table"),
        Family("friction", friction, (10, 30, 100, 200), True, "a block with Coulomb friction"),
        Family("hysteresis", hysteresis, (10, 30, 100, 300), False, "the play operator"),
        Family("cournot", cournot, (4, 10, 30, 100), False, "a leader among producers"),
        Family("markets", markets, (2, 5, 15, 60), False, "taxes on competing firms"),
        Family("tolls", tolls, (3, 6, 12, 40), False, "tolls on a network in equilibrium"),
    )
}

__all__ = ["FAMILIES", "Builder", "Family", "Instance"]
