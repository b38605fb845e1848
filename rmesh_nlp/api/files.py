"""Problems and results from files."""

from __future__ import annotations

from pathlib import Path

from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import read_results
from rmesh_nlp.problem import ContactProblem


def read_problem(path: str | Path) -> ContactProblem:
    """The contact problem that a TOML file states; ``rmesh new my.toml`` writes a template.

    Raises
    ------
    ValueError
        With one line per error, each naming file, key, value and what was expected.
    """
    return load_problem(path)


def read_records(folder: str | Path) -> list[Record]:
    """The records of a folder that ``rmesh solve`` or ``rmesh compare`` wrote, oldest first.

    ``pandas.DataFrame(read_records(folder))`` makes a table of them.

    Raises
    ------
    ValueError
        If the folder holds none, or a line is not a record.
    """
    return [result.record for result in read_results(Path(folder))]
