"""Study files: the keys of their tables, reading them with one line per error, and a commented template."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    ValidationError,
    model_validator,
)

from rmesh_nlp.io.problem_file import read_toml
from rmesh_nlp.io.problem_messages import schema_errors
from rmesh_nlp.io.problem_schema import Table
from rmesh_nlp.io.problem_values import LARGEST, Context, ObjectiveText, Quadrature, Seed, Text, expected

Kind = Literal["scalar", "membrane", "elastic", "rough"]
"""Kinds of :func:`rmesh_nlp.examples.random_problems.random_problem`."""

Count = Annotated[int, Field(strict=True, ge=1, le=10_000), expected("a whole number from 1 to 10000")]
Positive = Annotated[
    float, Field(strict=True, gt=0, lt=LARGEST, allow_inf_nan=False), expected("a positive number")
]


def _size(value: Any) -> tuple[int, int] | int:
    """``8`` or ``"12x6"``."""
    if isinstance(value, int) and not isinstance(value, bool) and 2 <= value <= 1000:
        return value
    if isinstance(value, str) and re.fullmatch(r"[0-9]{1,4}x[0-9]{1,4}", value):
        nx, ny = map(int, value.split("x"))
        if min(nx, ny) >= 2:
            return nx, ny
    raise ValueError("expected sizes such as 8 or '12x6', of at least 2")


def _sizes(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: tuple(_size(item) for item in _items(sizes)) for name, sizes in value.items()}
    return tuple(_size(item) for item in _items(value))


def _items(value: Any) -> list[Any]:
    if not isinstance(value, list) or not value:
        raise ValueError("expected a list such as [1, 2]")
    return value


def _seeds(value: Any) -> tuple[int | None, ...]:
    seeds: list[int | None] = []
    for item in _items(value):
        if item == "given":
            seeds.append(None)
        elif isinstance(item, int) and not isinstance(item, bool) and item >= 0:
            seeds.append(item)
        else:
            raise ValueError("expected seeds such as ['given', 1, 2]")
    return tuple(dict.fromkeys(seeds))


def _orders(value: Any) -> tuple[int, ...]:
    """``2`` or ``[1, 2]``."""
    items = value if isinstance(value, list) else [value]
    if not items or any(type(item) is not int or item not in (1, 2) for item in items):
        raise ValueError("expected 1 for linear displacements, 2 for quadratic ones, or [1, 2]")
    return tuple(dict.fromkeys(items))


def _formulations(value: Any) -> Any:
    """A list of names, or a table of tables."""
    if isinstance(value, list) and value and all(isinstance(name, str) for name in value):
        return {name: {} for name in value}
    if not isinstance(value, dict) or not value:
        raise ValueError("expected names such as ['fixed', 'joint'], or tables [formulations.<name>]")
    return value


def _texts(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(item, str) and item for item in value):
        raise ValueError("expected a list of texts")
    return tuple(dict.fromkeys(value))


Texts = Annotated[tuple[str, ...], BeforeValidator(_texts)]


class RandomTable(Table):
    """``random``: so many random contact problems, numbered from a seed."""

    seed: Seed = 0
    count: Count
    kinds: tuple[Kind, ...] = get_args(Kind)


class FormulationTable(BaseModel):
    """``[formulations.<name>]``: a formulation, by default that of the name, and its settings."""

    model_config = ConfigDict(extra="allow", frozen=True)

    __pydantic_extra__: dict[str, JsonValue] = Field(init=False)
    formulation: Text | None = None

    @property
    def keywords(self) -> dict[str, Any]:
        """Options by name, as on the command line."""
        return dict(self.model_extra or {})


class LimitsTable(Table):
    """``[limits]`` of each solve: seconds, megabytes, iterations."""

    time: Positive = 60.0
    memory: Positive = 4000.0
    iterations: Count | None = None


class StudyTable(Table):
    """A whole study file."""

    name: Text | None = None
    question: str = ""
    examples: Texts = ()
    files: Texts = ()
    random: RandomTable | None = None
    sizes: Annotated[Any, BeforeValidator(_sizes)] = None
    order: Annotated[tuple[int, ...], BeforeValidator(_orders)] = ()
    quadrature: Quadrature | None = None
    formulations: Annotated[dict[str, FormulationTable], BeforeValidator(_formulations)]
    objectives: Annotated[tuple[ObjectiveText, ...], BeforeValidator(_texts)] = ("energy",)
    seeds: Annotated[Any, BeforeValidator(_seeds)] = (None,)
    repeats: Count = 1
    fields: bool = True
    certify: bool = False
    limits: LimitsTable = Field(default_factory=LimitsTable)

    @model_validator(mode="after")
    def _something_to_solve(self) -> StudyTable:
        if not (self.examples or self.files or self.random):
            raise ValueError("expected examples, files or random: there is nothing to solve")
        for name in self.sizes if isinstance(self.sizes, dict) else ():
            if name not in self.examples:
                raise ValueError(f"sizes.{name}: {name!r} is not among the examples of the study")
        return self


def read_study(path: str | Path) -> StudyTable:
    """The checked tables of a study file; a ProblemFileError has one line per error."""
    path = Path(path)
    data = read_toml(path)
    try:
        return StudyTable.model_validate(data, context=Context(path.parent))
    except ValidationError as error:
        raise schema_errors(path, error, data, StudyTable) from None


def is_study(path: str | Path) -> bool:
    """Whether a TOML file states a study rather than a problem."""
    return "formulations" in read_toml(Path(path))


def template(name: str, file: str) -> str:
    """The commented template of ``rmesh new --study``: a study ``name`` in ``file`` of some seconds."""
    text = files("rmesh_nlp.study").joinpath("template.toml").read_text(encoding="utf-8")
    return text.replace("{name}", name).replace("{file}", file)
