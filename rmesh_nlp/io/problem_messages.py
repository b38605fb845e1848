"""Errors in problem files as one line each: file, key, value, and what was expected."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any, get_args, get_origin

import casadi as ca
from pydantic import BaseModel, ValidationError

from rmesh_nlp.errors import BadInputError, Place, nearest, one_line
from rmesh_nlp.problem.design import RESERVED, symbol


class ProblemFileError(BadInputError):
    """A problem file that cannot be used; ``lines`` has one line per error."""

    def __init__(self, lines: list[str]) -> None:
        super().__init__("\n".join(lines))
        self.lines = lines


def value_at(data: object, place: Place) -> object:
    """What stands at a place of nested tables; None where nothing does."""
    value = data
    for part in place:
        if isinstance(part, int):  # one table may stand in the place of a list of one
            value = next(iter(value[part:]), None) if isinstance(value, list) else value
        else:
            value = value.get(part) if isinstance(value, dict) else None
    return value


def outwards(place: Place) -> list[Place]:
    """A place, and those around it."""
    return [place[:depth] for depth in range(len(place), 0, -1)]


@dataclass(frozen=True)
class Source:
    """A file with its tables as they stand there; its errors name places and quote what stands there."""

    path: Path
    data: Mapping[str, object]

    @cached_property
    def symbols(self) -> dict[str, ca.SX]:
        """Those of the design variables that it declares, by name."""
        names: list[str] = []
        for table in (value_at(self.data, ("design",)), value_at(self.data, ("design", "shapes"))):
            names += table if isinstance(table, dict) else ()
        own = [name for name in names if name.isidentifier() and name not in ("shapes", *RESERVED)]
        return {name: symbol(name) for name in own}

    def first(self, places: list[Place]) -> Place:
        """The first of some places where something stands, or else the last."""
        return next((place for place in places if value_at(self.data, place) is not None), places[-1])

    def key(self, place: Place) -> str:
        """The name of a place: ``contact[2].friction``."""
        parts = [
            (f".{part}" if isinstance(part, str) else f"[{part + 1}]")
            for number, part in enumerate(place)
            if isinstance(part, str) or isinstance(value_at(self.data, place[:number]), list)
        ]
        return one_line("".join(parts).removeprefix("."))

    def line(self, place: Place, said: str) -> str:
        """The line of an error: place, what stands there, and what is wrong with it."""
        return f"{self.key(place)} = {as_text(value_at(self.data, place))}: {said}"

    def error(self, place: Place, said: str) -> ProblemFileError:
        """The error at one place."""
        return ProblemFileError([f"{self.path}: {self.line(place, said)}"])

    @contextmanager
    def at(self, *place: str | int) -> Iterator[None]:
        """Name file and place in any ValueError that does not yet.

        An error that names the argument to which it belongs is one of the entry of that name there, or of a
        table around it.
        """
        try:
            yield
        except ProblemFileError:
            raise
        except ValueError as error:
            inside = getattr(error, "place", ())
            entries = [(*table, *inside) for table in outwards(place)] if inside else []
            raise self.error(self.first([*entries, place]), one_line(error)) from error


def as_text(value: object) -> str:
    """A value as it stands in a file, cut to 60 characters."""
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


MOST = 10
"""Errors of one file that are said in a line each."""


def schema_errors(source: Source, error: ValidationError, file: type[BaseModel]) -> ProblemFileError:
    """Pydantic's errors, one line each up to ``MOST``; ``file`` is the model of a whole file."""
    tables, errors = {"": file, **dict(_tables(file))}, error.errors()
    unknown = [item["loc"] for item in errors if item["type"] == "extra_forbidden"]
    for item in [item for item in errors if item["type"] == "missing"]:
        *table, name = item["loc"]
        if get_close_matches(str(name), [str(key) for *place, key in unknown if place == table]):
            errors.remove(item)  # that is what the unknown key means
    lines = [_line(item, source, tables) for item in errors[:MOST]]
    rest = [f"and {len(errors) - MOST} more errors"] if len(errors) > MOST else []
    return ProblemFileError([f"{source.path}: {line}" for line in lines + rest])


def _line(item: Any, source: Source, tables: Mapping[str, type[BaseModel]]) -> str:
    place = item["loc"]
    message = one_line(item["msg"]).removeprefix("Value error, ")
    if not place:
        return message
    if item["type"] == "extra_forbidden":
        names = [part for part in place[:-1] if isinstance(part, str)]
        own, any_name = ".".join(names), ".".join([*names[:-1], "*"])
        table = own if own in tables else any_name if any_name in tables else None
        suggestion = "" if table is None else nearest(place[-1], tables[table].model_fields)
        message = f"unknown key{_home(place[-1], table, tables) or suggestion}"
    elif item["type"] == "missing":
        message = "expected, but it is missing"
    elif item["type"] == "literal_error":
        message = f"expected {item['ctx']['expected']}"
    elif item["type"] in ("model_type", "dict_type", "tuple_type", "model_attributes_type"):
        message = f"expected a table [{source.key(place)}]"
    return source.line(place, message)


def _tables(model: type[BaseModel], head: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Place and model of each table inside a table; ``*`` stands for the names of several."""
    for name, field in model.model_fields.items():
        for kind in _models(field.annotation):
            place = f"{head}{name}{'.*' if get_origin(field.annotation) is dict else ''}"
            yield place, kind
            yield from _tables(kind, f"{place}.")


def _models(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


def _home(name: str, table: str | None, tables: Mapping[str, type[BaseModel]]) -> str:
    """The end of a message about a key that stands in the wrong table; empty if none near it has it."""
    homes = [
        place
        for place, model in tables.items()
        if name in model.model_fields and "*" not in place and place.rpartition(".")[0] in ("", table)
    ]
    if inside := [place for place in homes if place]:
        return f" here: it belongs in {' or '.join(f'[{place}]' for place in inside)}"
    return " here: it belongs at the top of the file" if homes else ""


def unquoted(raw: bytes, error: str) -> str:
    """What to say if the line at which TOML fails has an expression without quotes, else nothing."""
    place = re.search(r"line (\d+)", error)
    lines = raw.decode(errors="replace").splitlines()
    number = int(place.group(1)) if place else len(lines)
    line = lines[number - 1] if 0 < number <= len(lines) else ""
    entry = re.match(r"\s*([\w.-]+\s*=\s*[^#\"\']+)", line)
    if entry is None or not re.search(r"=.*([xy]\b|\*|\(|[0-9]\s*[-+/^])", entry[1]):
        return ""
    return f'{entry[1].strip()}: expressions need quotes (line {number}), as in "2*x"'
