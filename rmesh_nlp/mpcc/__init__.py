"""A general solver for mathematical programs with complementarity constraints.

>>> from rmesh_nlp.mpcc import MPCC, solve
"""

from rmesh_nlp.mpcc.classify import Classification, classify
from rmesh_nlp.mpcc.mpccsol import mpccsol
from rmesh_nlp.mpcc.multistart import MultiStart, multistart
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.reading import Problem, read
from rmesh_nlp.mpcc.relaxations import RELAXATIONS
from rmesh_nlp.mpcc.result import Duals, MPCCResult, Step
from rmesh_nlp.mpcc.run import Iterate
from rmesh_nlp.mpcc.solver import MPCCSolver, solve

__all__ = [
    "MPCC",
    "RELAXATIONS",
    "Classification",
    "Duals",
    "Iterate",
    "MPCCResult",
    "MPCCSolver",
    "MultiStart",
    "Options",
    "Problem",
    "Step",
    "classify",
    "mpccsol",
    "multistart",
    "read",
    "solve",
]
