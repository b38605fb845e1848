"""A general solver for mathematical programs with complementarity constraints.

>>> from rmesh_nlp.mpcc import MPCC, solve
"""

from rmesh_nlp.mpcc.bilevel import bilevel
from rmesh_nlp.mpcc.bilevel_solve import BilevelResult, solve_bilevel
from rmesh_nlp.mpcc.lower_level import LowerLevel, LowerLevelCheck
from rmesh_nlp.mpcc.mpccsol import mpccsol
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.reading import Problem, read
from rmesh_nlp.mpcc.relaxations import RELAXATIONS
from rmesh_nlp.mpcc.result import Duals, Iterate, MPCCResult, Reached, Stage, shift
from rmesh_nlp.mpcc.solver import MPCCSolver, classify, solve

__all__ = [
    "MPCC",
    "RELAXATIONS",
    "BilevelResult",
    "Duals",
    "Iterate",
    "LowerLevel",
    "LowerLevelCheck",
    "MPCCResult",
    "MPCCSolver",
    "Options",
    "Problem",
    "Reached",
    "Stage",
    "bilevel",
    "classify",
    "mpccsol",
    "read",
    "shift",
    "solve",
    "solve_bilevel",
]
