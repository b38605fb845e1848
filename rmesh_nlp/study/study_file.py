"""Studies from TOML files; every error is one line: file, key, value, what was expected."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from rmesh_nlp.io.problem_file import read_toml
from rmesh_nlp.io.problem_messages import ProblemFileError, as_text, nearest, one_line
from rmesh_nlp.study.schema import LimitsTable, RandomTable, StudyTable

OLD = "strategies"
"""What ``formulations`` was called up to 0.1."""

_TABLES: dict[str, type[BaseModel]] = {"": StudyTable, "random": RandomTable, "limits": LimitsTable}


def read_study(path: str | Path) -> StudyTable:
    """The checked tables of a study file.

    Raises
    ------
    ProblemFileError
        With one line per error.

    Warns
    -----
    DeprecationWarning
        If formulations are called strategies.
    """
    path = Path(path)
    data = read_toml(path)
    if OLD in data and "formulations" not in data:
        data["formulations"] = data.pop(OLD)
        warnings.warn(f"{path}: {OLD} is now called formulations", DeprecationWarning, stacklevel=2)
    try:
        return StudyTable.model_validate(data)
    except ValidationError as error:
        raise ProblemFileError([_line(path, item) for item in error.errors()]) from None


def is_study(path: str | Path) -> bool:
    """Whether a TOML file states a study rather than a problem."""
    return bool({"formulations", OLD} & read_toml(Path(path)).keys())


def _line(path: Path, item: Any) -> str:
    location = [str(part) for part in item["loc"]]
    key, value = ".".join(location) or "file", as_text(item["input"])
    if item["type"] == "extra_forbidden":
        known = list(_TABLES.get(".".join(location[:-1]), StudyTable).model_fields)
        return f"{path}: {key} = {value}: unknown key{nearest(location[-1], known)}"
    if item["type"] == "missing":
        return f"{path}: {key} = nothing: expected, but it is missing"
    if item["type"] == "literal_error":
        return f"{path}: {key} = {value}: expected {item['ctx']['expected']}"
    message = one_line(item["msg"]).removeprefix("Value error, ")
    return f"{path}: {message}" if not location else f"{path}: {key} = {value}: {message}"
