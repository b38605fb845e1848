"""Errors in problem files as one line each: file, key, value, and what was expected."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.problem_schema import (
    CircleTable,
    ContactTable,
    LineTable,
    MaterialTable,
    MeshTable,
    MotionTable,
    PathTable,
    PointLoadTable,
    ProblemTable,
    SolveTable,
    UnitsTable,
)


class ProblemFileError(BadInputError):
    """A problem file that cannot be used; ``lines`` has one line per error."""

    def __init__(self, lines: list[str]) -> None:
        super().__init__("\n".join(lines))
        self.lines = lines


@contextmanager
def at_key(path: Path, key: str, table: ProblemTable) -> Iterator[None]:
    """Name file, key and value in any ValueError that is not yet one of a problem file."""
    try:
        yield
    except ProblemFileError:
        raise
    except ValueError as error:
        raise error_at(path, key, shown(table, key), one_line(error)) from error


def value_at(table: ProblemTable, key: str) -> Any:
    """What stands at a dotted key; the last part of the key is a name or a field.

    ``contact`` is the only contact, ``contact[1]`` the first of several.
    """
    value: Any = table
    for part in key.split(".", 1):
        name, bracket, number = part.partition("[")
        value = value.get(part) if isinstance(value, dict) else getattr(value, name, None)
        if isinstance(value, tuple) and name in LISTS:
            value = value[int(number.rstrip("]")) - 1] if bracket else value[0]
    return value


def contact_key(table: ProblemTable, number: int) -> str:
    """Key of one contact, counted from 0, for messages."""
    return "contact" if len(table.contact) == 1 else f"contact[{number + 1}]"


def shown(table: ProblemTable, key: str) -> str:
    """What stands at a key, as text."""
    value = value_at(table, key)
    return as_text(value.model_dump(exclude_unset=True) if isinstance(value, BaseModel) else value)


def error_at(path: Path, key: str, value: str, expected: str) -> ProblemFileError:
    """The error of one key."""
    return ProblemFileError([f"{path}: {key} = {value}: {expected}"])


def pydantic_line(path: Path, item: Any, data: dict[str, Any]) -> str:
    """One of pydantic's errors as one line."""
    location = [str(part) for part in item["loc"]]
    if location[:1] and location[0] in LISTS and len(location) > 1 and location[1].isdigit():
        number = int(location.pop(1))
        if isinstance(data[location[0]], list):
            location[0] = f"{location[0]}[{number + 1}]"
    key = ".".join(location) or "file"
    if item["type"] == "extra_forbidden":
        hint = _home(location[-1]) or nearest(location[-1], _known_keys(location[:-1]))
        return f"{path}: {key} = {as_text(item['input'])}: unknown key{hint}"
    if item["type"] == "missing":
        return f"{path}: {key} = nothing: expected, but it is missing"
    if item["type"] == "literal_error":
        return f"{path}: {key} = {as_text(item['input'])}: expected {item['ctx']['expected']}"
    if item["type"] in ("model_type", "dict_type", "tuple_type", "model_attributes_type"):
        return f"{path}: {key} = {as_text(item['input'])}: expected a table [{key}]"
    message = one_line(item["msg"]).removeprefix("Value error, ")
    if not location:
        return f"{path}: {key}: {message}"
    return f"{path}: {key} = {as_text(item['input'])}: {message}"


LISTS = ("contact", "point_loads")
"""Tables of which a file may have several."""

_TABLES: dict[str, type[BaseModel]] = {
    "mesh": MeshTable,
    "material": MaterialTable,
    "materials": MaterialTable,
    "contact": ContactTable,
    "contact.line": LineTable,
    "contact.circle": CircleTable,
    "point_loads": PointLoadTable,
    "units": UnitsTable,
    "path": PathTable,
    "motion": MotionTable,
    "solve": SolveTable,
}


def _known_keys(location: list[str]) -> list[str]:
    """Keys that the table at this place may have."""
    place = "materials" if location[:1] == ["materials"] else re.sub(r"\[\d+\]", "", ".".join(location))
    return list(_TABLES.get(place, ProblemTable).model_fields)


def _home(name: str) -> str:
    """The end of a message about a key that stands in the wrong table; empty if no table has it."""
    homes = [place for place, table in _TABLES.items() if name in table.model_fields and place != "materials"]
    if homes:
        return f" here: it belongs in {' or '.join(f'[{place}]' for place in homes)}"
    return " here: it belongs at the top of the file" if name in ProblemTable.model_fields else ""


def nearest(name: str, known: list[str]) -> str:
    """The end of a message about an unknown name."""
    if not known:
        return ", which has none"
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
    return f", did you mean {close[0]!r}?" if close else f": one of {', '.join(known)}"


def as_text(value: Any) -> str:
    """A value as it stood in the file, cut to 60 characters."""
    text = "nothing" if value is None else repr(_plain(value))
    return text if len(text) <= 60 else text[:57] + "..."


def _plain(value: Any) -> Any:
    """A checked value as it stood in the file."""
    if isinstance(value, BaseModel):
        return _plain(value.model_dump(exclude_unset=True))
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return ["free" if item is None else _plain(item) for item in value]
    return getattr(value, "text", value)


def one_line(error: Any) -> str:
    """The message of an error without line breaks."""
    return " ".join(str(error).split())


def unquoted(raw: bytes, error: str) -> str:
    """What to say if the line that TOML stumbles over has an expression without quotes, else nothing."""
    place = re.search(r"line (\d+)", error)
    lines = raw.decode(errors="replace").splitlines()
    number = int(place.group(1)) if place else len(lines)
    line = lines[number - 1] if 0 < number <= len(lines) else ""
    entry = re.match(r"\s*([\w.-]+)\s*=\s*([^#\"\']+)", line)
    if entry is None:
        return ""
    key, value = entry.group(1), entry.group(2).strip()
    if not re.search(r"[xy]\b|\*|\(|[0-9]\s*[-+/^]", value):
        return ""
    return f"{key} = {value}: expressions need quotes (line {number}), as in {key} = {_in_quotes(value)}"


def deepest_line(raw: bytes) -> int:
    """Number of the line of a TOML file at which most brackets are open, or with most parts in its key."""
    deepest, found, opened = 0, 1, 0
    for number, line in enumerate(raw.decode(errors="replace").splitlines(), 1):
        bare = re.sub(r"\"[^\"]*\"|'[^']*'|#.*", "", line)
        here = opened + bare.count("[") + bare.count("{") + bare.partition("=")[0].count(".")
        opened += sum(bare.count(sign) for sign in "[{") - sum(bare.count(sign) for sign in "]}")
        if here > deepest:
            deepest, found = here, number
    return found


def _in_quotes(value: str) -> str:
    """The value with quotes around it, or around its items."""
    items = re.fullmatch(r"\[(.*)\]", value)
    if items is None:
        return f'"{value}"'
    parts = [part.strip() for part in items.group(1).split(",")]
    numbers = r"[-+]?[\d.]+([eE][-+]?\d+)?"
    return "[" + ", ".join(p if re.fullmatch(numbers, p) else f'"{p}"' for p in parts) + "]"
