"""Contact problems from TOML files. Every error is one line: file, key, value, what was expected."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from rmesh_nlp.errors import expect_path, one_line
from rmesh_nlp.io import problem_messages as messages
from rmesh_nlp.io.folder import write_whole
from rmesh_nlp.io.problem_builder import build
from rmesh_nlp.io.problem_messages import ProblemFileError, Source
from rmesh_nlp.io.problem_schema import ProblemTable
from rmesh_nlp.meshes.reading import FORMATS
from rmesh_nlp.problem import ContactProblem

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib  # type: ignore[import-not-found,unused-ignore]

DEEPEST = 20  # how deep tables and lists may be nested; a valid file needs five

MARKS = {"mesh": "problem file: use rmesh solve", "formulations": "study file: use rmesh study"}
"""The key that a file of each kind needs."""

KEPT, MESH = "problem.toml", "given-mesh"
"""Names of the copies of a problem file and, without its ending, of its mesh file beside a solution."""

T = TypeVar("T", bound=BaseModel)


def template(package: str = "rmesh_nlp.io", form: str = "template.toml", **values: object) -> str:
    """A commented template of ``rmesh new``, that of a problem or a study, with the values of its names.

    It solves in a second.
    """
    text = files(package).joinpath(form).read_text(encoding="utf-8")
    for name, value in values.items():
        text = text.replace(f"{{{name}}}", str(value))
    return text


def load_problem(path: str | Path, order: int | None = None) -> ContactProblem:
    """The contact problem of a TOML file, or the same with displacements of another order.

    Raises
    ------
    ProblemFileError
        With one line per error, each naming file, key, value and what was expected.
    """
    return build(read_table(path), order)


def read_table(path: str | Path) -> ProblemTable:
    """The checked tables of a problem file, its mesh not yet read."""
    return read_tables(path, ProblemTable)


def read_tables(path: str | Path, kind: type[T]) -> T:
    """The checked tables of a file of a kind; a ProblemFileError has one line per error."""
    expect_path(path)
    source = Source(Path(path), read_toml(Path(path)))
    marks = MARKS.keys() & source.data
    if marks and not marks & kind.model_fields.keys():
        raise ProblemFileError([f"{path}: this is a {MARKS[marks.pop()]}"])
    try:
        return kind.model_validate(source.data, context=source)
    except ValidationError as error:
        raise messages.schema_errors(source, error, kind) from error


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file as they stand there; an expression without quotes is named in the error."""
    meant = f"; a problem file is meant, as {path}.toml (of a mesh: rmesh new my.toml --mesh MESH writes one)"
    if path.suffix.lower() in FORMATS:
        meant = f"; a problem file is meant: rmesh new {path.stem}.toml --mesh {path} writes one"
    meant *= path.suffix != ".toml"
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise ProblemFileError([f"{path}: cannot be read: {error.strerror}{meant}"]) from error
    try:
        data = tomllib.loads(raw.decode())
        if _depth(data) > DEEPEST:
            raise RecursionError
    except ValueError as error:  # of the decoding and of endless whole numbers as well
        said = messages.unquoted(raw, str(error)) or f"is not valid TOML: {one_line(error)}{meant}"
        raise ProblemFileError([f"{path}: {said}"]) from error
    except RecursionError as error:
        said = f"tables and lists are nested more than {DEEPEST} deep"
        raise ProblemFileError([f"{path}: {said}"]) from error
    return data


def _depth(data: object) -> int:
    """How deep tables and lists are nested; no function calls itself, however deep that is."""
    depth, level = 0, [data]
    while level := [item for item in level if isinstance(item, (dict, list))]:
        depth += 1
        level = [v for item in level for v in (item.values() if isinstance(item, dict) else item)]
    return depth


def kept_files(table: ProblemTable) -> dict[str, Path]:
    """What is kept beside a solution, by name what it is a copy of: the problem, and its mesh file."""
    path, mesh = table.source.path, table.mesh.file
    return {KEPT: path} | ({} if mesh is None else {MESH + Path(mesh).suffix: path.parent / mesh})


def keep(copies: Mapping[str, Path], folder: Path) -> None:
    """Copy files into a folder, by their names there."""
    for name, source in copies.items():
        write_whole(folder / name, partial(shutil.copyfile, source))
