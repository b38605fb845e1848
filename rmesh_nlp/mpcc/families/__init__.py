"""Families of generated MPCCs: seeded, of any size, to choose settings on and to measure with.

>>> from rmesh_nlp.mpcc.families import FAMILIES
>>> FAMILIES["bouncing"].make(20, 0).name
'bouncing-20-0'
"""

from rmesh_nlp.mpcc.families.equilibria import cournot, obstacle_control, tolls
from rmesh_nlp.mpcc.families.instance import Builder, Family, Instance
from rmesh_nlp.mpcc.families.leaders import leader, markets, path_tolls, polynomial
from rmesh_nlp.mpcc.families.random_programs import bilevel, lpec, qpec
from rmesh_nlp.mpcc.families.sliding_modes import sliding_modes
from rmesh_nlp.mpcc.families.switched import (
    bouncing,
    friction,
    hysteresis,
    sliding,
    switch_detection,
)

FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        Family("qpec", qpec, (4, 10, 30, 100), True, "random quadratic programs over linear pairs"),
        Family("bilevel", bilevel, (4, 10, 30, 100), True, "leaders over quadratic lower levels"),
        Family("sliding", sliding, (10, 30, 100, 300), True, "a discontinuous right-hand side"),
        Family("obstacle-control", obstacle_control, (4, 8, 16, 24), True, "control of a membrane"),
        Family("switch-detection", switch_detection, (3, 10, 30), True, "steps that end at switches"),
        Family("sliding-modes", sliding_modes, (3, 6, 12), True, "two surfaces, a target hit exactly"),
        Family("leader", leader, (2, 4, 8, 30), True, "bilevel programs in whole numbers"),
        Family("polynomial", polynomial, (3, 8, 20, 80), True, "quartics over linear pairs"),
        Family("path-tolls", path_tolls, (5, 8, 15, 50), True, "tolls and shortest paths"),
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
