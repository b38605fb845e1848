"""Formulations by name, solved once as they are: without the second solve that follows an exploited end."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rmesh_nlp as rm
from support.solved import solve_once


def alternating() -> type[rm.Formulation]:
    """The formulation of docs/own_formulation.md."""
    page = (Path(__file__).parents[2] / "docs" / "own_formulation.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", page, re.S)
    space: dict[str, Any] = {}
    exec(compile(block, "own_formulation.md", "exec", dont_inherit=True), space)
    return space["Alternating"]


@dataclass(frozen=True)
class Named:
    """A formulation of this package."""

    name: str

    def solve(self, problem: rm.ContactProblem, **options: Any) -> rm.Solution:
        """Solve with options by name."""
        return solve_once(problem, self.name, **options)


auto, fixed, joint, mpcc, nested = (Named(name) for name in ("auto", "fixed", "joint", "mpcc", "nested"))
