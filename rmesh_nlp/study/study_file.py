"""Studies from TOML files; every error is one line: file, key, value, what was expected."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from rmesh_nlp.io.problem_file import LARGEST_FILE
from rmesh_nlp.io.problem_messages import ProblemFileError, as_text, nearest, one_line
from rmesh_nlp.study.schema import LimitsTable, RandomTable, StudyTable

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found,unused-ignore]

_TABLES: dict[str, type[BaseModel]] = {"": StudyTable, "random": RandomTable, "limits": LimitsTable}


def read_study(path: str | Path) -> StudyTable:
    """The checked tables of a study file.

    Raises
    ------
    ProblemFileError
        With one line per error.
    """
    path = Path(path)
    data = _toml(path)
    try:
        return StudyTable.model_validate(data)
    except ValidationError as error:
        raise ProblemFileError([_line(path, item) for item in error.errors()]) from None


def is_study(path: str | Path) -> bool:
    """Whether a TOML file states a study rather than a problem."""
    return "strategies" in _toml(Path(path))


def _toml(path: Path) -> dict[str, Any]:
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ProblemFileError([f"{path}: cannot be read: {error.strerror}"]) from error
    if len(raw) > LARGEST_FILE:
        raise ProblemFileError([f"{path}: has {len(raw)} bytes: more than {LARGEST_FILE} are not read"])
    try:
        return tomllib.loads(raw.decode())
    except (ValueError, RecursionError) as error:  # of the decoding as well
        raise ProblemFileError([f"{path}: is not valid TOML: {one_line(error)}"]) from error


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
