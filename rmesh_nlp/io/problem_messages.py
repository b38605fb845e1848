"""Errors in problem files as one line each: file, key, value, and what was expected."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, get_args

import casadi as ca
from pydantic import BaseModel, ValidationError

from rmesh_nlp.errors import BadInputError

LISTS = ("contact", "point_loads", "constraints")  # tables of which a file may have several
NAMED = ("materials", "formulations")  # tables of tables by names


class ProblemFileError(BadInputError):
    """A problem file that cannot be used; ``lines`` has one line per error."""

    def __init__(self, lines: list[str]) -> None:
        super().__init__("\n".join(lines))
        self.lines = lines


@contextmanager
def at_key(path: Path, key: str, value: Any) -> Iterator[None]:
    """Name file, key and value in any ValueError that is not yet one of a problem file."""
    try:
        yield
    except ProblemFileError:
        raise
    except ValueError as error:
        raise error_at(path, key, value, one_line(error)) from error


def error_at(path: Path, key: str, value: Any, expected: str) -> ProblemFileError:
    """The error of one key, with what stands there."""
    return ProblemFileError([f"{path}: {key} = {as_text(value)}: {expected}"])


def as_text(value: Any) -> str:
    """A value as it stood in the file, cut to 60 characters."""
    text = "nothing" if value is None else repr(_plain(value))
    return text if len(text) <= 60 else text[:57] + "..."


def _plain(value: Any) -> Any:
    """A checked value as it stood in the file."""
    if isinstance(value, BaseModel):
        value = value.model_dump(exclude_unset=True)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, ca.SX):
        return str(value)
    if isinstance(value, (list, tuple)):
        return ["free" if item is None else _plain(item) for item in value]
    return getattr(value, "text", value)


def one_line(error: Any) -> str:
    """The message of an error without line breaks."""
    return " ".join(str(error).split())


def schema_errors(
    path: Path, error: ValidationError, data: dict[str, Any], file: type[BaseModel]
) -> ProblemFileError:
    """All of pydantic's errors, one line each; ``file`` is the model of a whole file."""
    tables = {"": file, **dict(_tables(file))}
    return ProblemFileError([f"{path}: {_line(item, data, tables)}" for item in error.errors()])


def _line(item: Any, data: dict[str, Any], tables: Mapping[str, type[BaseModel]]) -> str:
    place, value = [str(part) for part in item["loc"]], as_text(item["input"])
    if len(place) > 1 and place[0] in LISTS and place[1].isdigit():
        number = int(place.pop(1)) + 1
        place[0] += f"[{number}]" if isinstance(data[place[0]], list) else ""
    key = ".".join(place)
    message = one_line(item["msg"]).removeprefix("Value error, ")
    if not place:
        return message
    if item["type"] == "extra_forbidden":
        table = "materials" if place[0] == "materials" else re.sub(r"\[\d+\]", "", ".".join(place[:-1]))
        known = list(tables.get(table, tables[""]).model_fields)
        message = f"unknown key{_home(place[-1], tables) or nearest(place[-1], known)}"
    elif item["type"] == "missing":
        value, message = "nothing", "expected, but it is missing"
    elif item["type"] == "literal_error":
        message = f"expected {item['ctx']['expected']}"
    elif item["type"] in ("model_type", "dict_type", "tuple_type", "model_attributes_type"):
        message = f"expected a table [{key}]"
    return f"{key} = {value}: {message}"


def _tables(model: type[BaseModel], head: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Place and model of each table inside a table."""
    for name, field in model.model_fields.items():
        for kind in _models(field.annotation):
            yield head + name, kind
            yield from _tables(kind, f"{head}{name}.")


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


def _home(name: str, tables: Mapping[str, type[BaseModel]]) -> str:
    """The end of a message about a key that stands in the wrong table; empty if no table has it."""
    homes = [place for place, table in tables.items() if name in table.model_fields and place not in NAMED]
    if inside := [place for place in homes if place]:
        return f" here: it belongs in {' or '.join(f'[{place}]' for place in inside)}"
    return " here: it belongs at the top of the file" if homes else ""


def nearest(name: str, known: list[str]) -> str:
    """The end of a message about an unknown name."""
    if not known:
        return ", which has none"
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
    return f", did you mean {close[0]!r}?" if close else f": one of {', '.join(known)}"


def unquoted(raw: bytes, error: str) -> str:
    """What to say if the line at which TOML fails has an expression without quotes, else nothing."""
    place = re.search(r"line (\d+)", error)
    lines = raw.decode(errors="replace").splitlines()
    number = int(place.group(1)) if place else len(lines)
    line = lines[number - 1] if 0 < number <= len(lines) else ""
    entry = re.match(r"\s*([\w.-]+)\s*=\s*([^#\"\']+)", line)
    if entry is None or not re.search(r"[xy]\b|\*|\(|[0-9]\s*[-+/^]", entry.group(2).strip()):
        return ""
    key, value = entry.group(1), entry.group(2).strip()
    return f"{key} = {value}: expressions need quotes (line {number}), as in {key} = {_in_quotes(value)}"


def _in_quotes(value: str) -> str:
    """The value with quotes around it, or around its items."""
    items = re.fullmatch(r"\[(.*)\]", value)
    if items is None:
        return f'"{value}"'
    parts = [part.strip() for part in items.group(1).split(",")]
    numbers = r"[-+]?[\d.]+([eE][-+]?\d+)?"
    return "[" + ", ".join(p if re.fullmatch(numbers, p) else f'"{p}"' for p in parts) + "]"


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
