"""Study files: the keys of their tables, reading them with one line per error, and a commented template."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    SkipValidation,
    model_validator,
)

from rmesh_nlp.examples.paper import as_size
from rmesh_nlp.io.problem_file import read_tables, read_toml
from rmesh_nlp.io.problem_schema import FileTable
from rmesh_nlp.io.problem_values import LARGEST, Flag, ObjectiveText, Seed, Text, as_list, expected

Kind = Literal["scalar", "membrane", "elastic", "rough"]
"""Kinds of :func:`rmesh_nlp.examples.random_problems.random_problem`."""


def _once(values: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(dict.fromkeys(values))


def _size(value: Any) -> Any:
    """A text as columns and rows; a number is what it is in the keys of solves."""
    as_size(value)
    return as_size(value) if isinstance(value, str) else value


def _formulations(value: Any) -> Any:
    """A list of names, or a table of tables."""
    if isinstance(value, list) and value and all(isinstance(name, str) for name in value):
        return {name: {} for name in value}
    if not isinstance(value, dict) or not value:
        raise ValueError("expected names such as ['fixed', 'joint'], or tables [formulations.<name>]")
    return value


Count = Annotated[int, Field(strict=True, ge=1, le=10_000), expected("a whole number from 1 to 10000")]
Positive = Annotated[
    float, Field(strict=True, gt=0, lt=LARGEST, allow_inf_nan=False), expected("a positive number")
]
Texts = Annotated[tuple[Text, ...], AfterValidator(_once), expected("a list of texts")]
Objectives = Annotated[tuple[ObjectiveText, ...], AfterValidator(_once), expected("a list of texts")]
_Sizes = Annotated[tuple[Annotated[Any, BeforeValidator(_size)], ...], Field(min_length=1)]
Sizes = Annotated[_Sizes | dict[str, _Sizes], expected("sizes such as [8, '12x6'] or { '6.1' = [8] }")]
Orders = Annotated[
    tuple[Annotated[int, Field(strict=True, ge=1, le=2)], ...],
    BeforeValidator(as_list),
    Field(min_length=1),
    AfterValidator(_once),
    expected("1 for linear displacements, 2 for quadratic ones, or [1, 2]"),
]
Seeds = Annotated[
    tuple[Literal["given"] | Annotated[int, Field(strict=True, ge=0)], ...],
    Field(min_length=1),
    AfterValidator(_once),
    expected("seeds such as ['given', 1, 2]"),
]


class RandomTable(FileTable):
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


class LimitsTable(FileTable):
    """``[limits]`` of each solve: seconds, megabytes, iterations."""

    seconds: Positive = 60.0
    memory: Positive = 4000.0
    iterations: Count | None = None


class StudyTable(FileTable):
    """A whole study file."""

    name: Text | None = None
    question: str = ""
    examples: Texts = ()
    files: Texts = ()
    random: RandomTable | None = None
    sizes: Sizes = ()
    order: Orders = ()
    quadrature: SkipValidation[str | int | None] = None
    formulations: Annotated[dict[str, FormulationTable], BeforeValidator(_formulations)]
    objectives: Objectives = ("energy",)
    seeds: Seeds = ("given",)
    repeats: Count = 1
    fields: Flag = True
    certify: Flag = False
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
    return read_tables(path, StudyTable)


def is_study(path: str | Path) -> bool:
    """Whether a TOML file states a study rather than a problem."""
    return "formulations" in read_toml(Path(path))
