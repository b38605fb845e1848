"""Problems with something to see, in files and in Python, and what is seen."""

from pathlib import Path
from typing import Any

from rmesh_nlp.io.problem_builder import build
from rmesh_nlp.io.problem_file import read_table
from rmesh_nlp.problem import ContactProblem


def of_file(name: str, order: int | None = None, **mesh: Any) -> ContactProblem:
    """The problem of a file in this folder, with other arguments of its mesh."""
    table = read_table(Path(__file__).with_name(f"{name}.toml"))
    return build(table.model_copy(update={"mesh": table.mesh.model_copy(update=mesh)}), order)
