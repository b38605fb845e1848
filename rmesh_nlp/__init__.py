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
solver of mathematical programs with complementarity constraints, which knows nothing of meshes.

Every name is loaded when it is first used, so that ``rmesh --help`` starts at once.
"""

from functools import cache
from importlib import import_module

__version__ = "0.1.0"


@cache
def _public() -> dict[str, tuple[str, str]]:
    """Public name -> its module and its name there, from ``__init__.pyi``, which type checkers read too."""
    import ast
    from pathlib import Path

    seen: dict[str, tuple[str, str]] = {}
    public = set()
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text()).body:
        if isinstance(node, ast.ImportFrom):
            seen |= {one.name: (str(node.module), one.name) for one in node.names}
            public |= {one.name for one in node.names if one.asname}  # a stub exports what it names twice
        elif isinstance(node, ast.Assign):  # a name that differs from that in its module
            name, (module, there) = ast.unparse(node.targets[0]), ast.unparse(node.value).split(".")
            seen[name] = (".".join(seen[module]), there)
            public.add(name)
    return {name: seen[name] for name in sorted(public)}


def __getattr__(name: str) -> object:
    if name == "__all__":
        return ["__version__", *_public()]
    if name not in _public():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, there = _public()[name]
    value = None if module == __name__ else getattr(import_module(module), there, None)
    globals()[name] = value = import_module(f"{module}.{there}") if value is None else value
    return value


def __dir__() -> list[str]:
    return sorted({"__version__", *_public(), *(name for name in globals() if name.startswith("__"))})
