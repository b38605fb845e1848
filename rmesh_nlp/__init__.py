"""Finite-element mesh relocation for contact problems, as a bilevel NLP and MPCC.

>>> import rmesh_nlp as rm
>>> problem = rm.EXAMPLES["6.1"](n=8)
>>> solution = rm.solve(problem, "joint")  # or without a name: what suits the problem
>>> solution.success, round(solution.energy, 3)
(True, -1.475)

A problem is a :class:`ContactProblem`: a mesh, a law, supports, loads, an :class:`Obstacle` and a
:class:`Motion` that says how far nodes may move. :func:`solve` relocates its nodes by any
installed formulation, :func:`compare` by several; :func:`certify` bounds the error of the result. An
outer :func:`objective` is named, written as text, or made by :mod:`quantities`;
:func:`verify_gradient` tests its gradient. :class:`MPCC` and :func:`solve_mpcc` are the general
solver of programs with complementarity constraints, which knows nothing of meshes.

Every name is loaded when it is first used, so that ``rmesh --help`` starts at once.
"""

import importlib
from typing import Any

__version__ = "0.1.0"

_NAMES = {
    # stating a problem
    "Circle": "rmesh_nlp.meshes.curves",
    "ContactProblem": "rmesh_nlp.problem",
    "Dirichlet": "rmesh_nlp.problem",
    "ExactSolution": "rmesh_nlp.problem",
    "Laplace": "rmesh_nlp.problem",
    "Motion": "rmesh_nlp.problem",
    "Obstacle": "rmesh_nlp.problem",
    "Parametrised": "rmesh_nlp.meshes.curves",
    "PointLoad": "rmesh_nlp.problem",
    "Units": "rmesh_nlp.problem",
    "where": "rmesh_nlp.problem",
    "PlaneStrain": "rmesh_nlp.problem",
    "PlaneStress": "rmesh_nlp.problem",
    "ProblemError": "rmesh_nlp.problem",
    "Relative": "rmesh_nlp.problem",
    "Spline": "rmesh_nlp.meshes.curves",
    "Traction": "rmesh_nlp.problem",
    "EXAMPLES": "rmesh_nlp.examples",
    "read_mesh": "rmesh_nlp.meshes",
    "read_problem": "rmesh_nlp.io.problem_file",
    # solving it
    "Comparison": "rmesh_nlp.api.comparison",
    "Solution": "rmesh_nlp.solving.solution",
    "certify": "rmesh_nlp.solving.certify",
    "compare": "rmesh_nlp.api.comparison",
    "objective": "rmesh_nlp.fem.objective_text",
    "solve": "rmesh_nlp.solving.driver",
    "formulations": "rmesh_nlp.solving.formulation",
    "Limits": "rmesh_nlp.solving.clock",
    "verify_gradient": "rmesh_nlp.solving.verification",
    # looking at results
    "plot": "rmesh_nlp.api.results",
    "read_records": "rmesh_nlp.api.results",
    "write_solution": "rmesh_nlp.io.export",
    # programs with complementarity constraints
    "MPCC": "rmesh_nlp.mpcc",
    "solve_mpcc": "rmesh_nlp.mpcc.solver",
}
"""Public name -> the module that has it; ``__init__.pyi`` says the same to type checkers."""

_MODULES = {
    "mpcc": "rmesh_nlp.mpcc",
    "quantities": "rmesh_nlp.fem.quantities",
    "shapes": "rmesh_nlp.meshes.shapes",
}
"""Public name -> the module that it is."""

_OTHER_NAMES = {"objective": "parse_objective", "read_problem": "load_problem", "solve_mpcc": "solve"}
"""Public name -> its name in its module, where the two differ."""

__all__ = [
    "__version__",
    *sorted([*_NAMES, *_MODULES]),
]


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        value: Any = importlib.import_module(_MODULES[name])
    elif name in _NAMES:
        value = getattr(importlib.import_module(_NAMES[name]), _OTHER_NAMES.get(name, name))
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})
