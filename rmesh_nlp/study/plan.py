"""The solves of a study, each with a key made of its content: the same solve has the same key anywhere."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rmesh_nlp import __version__
from rmesh_nlp.errors import BadInputError, unknown
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.io.files import safe_name
from rmesh_nlp.io.problem_file import load_problem, read_table
from rmesh_nlp.solving.formulation import find
from rmesh_nlp.solving.options import accepted
from rmesh_nlp.study.schema import StudyTable

Problem = dict[str, Any]
"""What states a problem, as plain JSON values, see :func:`rmesh_nlp.study.problems.build`."""


@dataclass(frozen=True)
class PlannedSolve:
    """One solve to be done, as plain JSON values: it travels to other processes and machines.

    Attributes
    ----------
    problem : dict
        ``kind`` (example, file, random) and what states it.
    name, family, size : str
        Of the problem; a family is what summaries join.
    variant : str
        Its name in the study.
    formulation : str
        Name of an installed formulation.
    options : dict
        Of :func:`rmesh_nlp.solving.driver.solve_by_options`.
    repeat : int
        Number of the repetition, from 0.
    time_s, memory_mb : float
        Limits.
    fields : bool
        Whether meshes and fields are kept.
    certify : bool
        Whether the error is bounded.
    """

    problem: Problem
    name: str
    family: str
    size: str
    variant: str
    formulation: str
    options: dict[str, Any] = field(default_factory=dict)
    repeat: int = 0
    time_s: float = 60.0
    memory_mb: float = 4000.0
    fields: bool = True
    certify: bool = False

    @property
    def key(self) -> str:
        """A file name with a digest of problem, variant, options, limits, repetition and version."""
        content = {**asdict(self), "version": __version__}
        for entry in ("name", "family", "size", "fields"):
            del content[entry]
        content["strategy"] = content.pop("variant")  # its name when the first keys were made
        content["problem"] = {k: v for k, v in self.problem.items() if k != "path"}
        text = json.dumps(content, sort_keys=True)
        digest = hashlib.sha256(text.encode()).hexdigest()[:16]
        parts = [self.name, self.size, self.variant]
        return safe_name("-".join(part for part in parts if part)[:100] + "-" + digest)


def make_plan(study: StudyTable, path: Path) -> list[PlannedSolve]:
    """All solves of a study, in the order: problem, variant, objective, seed, repetition.

    A formulation that takes no seed or no objective is solved once, not once for each.

    Raises
    ------
    BadInputError
        If a name is unknown, a problem file is broken, or a formulation does not take an option.
    """
    for text in study.objectives:
        try:
            parse_objective(text)
        except ValueError as error:
            raise BadInputError(f"{path}: objectives: {error}") from error
    plan: dict[str, PlannedSolve] = {}
    rows = list(_formulations(study, path))
    for problem, name, family, size in _problems(study, path):
        for variant, formulation, options in rows:
            for repeat in range(study.repeats):
                solve = PlannedSolve(
                    problem,
                    name,
                    family,
                    size,
                    variant,
                    formulation,
                    options,
                    repeat,
                    study.limits.time,
                    study.limits.memory,
                    study.fields,
                    study.certify,
                )
                plan[solve.key] = solve
    return list(plan.values())


def _formulations(study: StudyTable, path: Path) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for variant, table in study.formulations.items():
        formulation = table.formulation or variant
        try:
            find(formulation)
        except BadInputError as error:
            raise BadInputError(f"{path}: formulations.{variant}: {error}") from error
        given = _checked(table.keywords, f"{path}: formulations.{variant}", formulation)
        limits = {"time_limit_s": study.limits.time}
        if study.limits.iterations is not None:
            limits["max_iterations"] = study.limits.iterations
        taken = accepted(formulation, limits)
        given = {**{name: value for name, value in limits.items() if name in taken}, **given}
        varied = accepted(formulation, ("objective", "seed"))
        seen = set()
        for objective in study.objectives:
            for seed in study.seeds:
                options = dict(given)
                if objective != "energy":
                    options.setdefault("objective", objective)
                if seed is not None and "seed" in varied:
                    options.setdefault("seed", seed)
                mark = json.dumps(options, sort_keys=True)
                if mark not in seen:
                    seen.add(mark)
                    yield variant, formulation, options


def _checked(keywords: Mapping[str, Any], where: str, formulation: str) -> dict[str, Any]:
    taken = accepted(formulation, keywords)
    for name, value in keywords.items():
        if name not in taken:
            raise BadInputError(f"{where}.{name} = {value!r}: not an option of {formulation}")
        try:
            json.dumps(value)
        except TypeError:
            raise BadInputError(f"{where}.{name} = {value!r}: dates and times are no options") from None
    return dict(keywords)


def _problems(study: StudyTable, path: Path) -> Iterator[tuple[Problem, str, str, str]]:
    for name in study.examples:
        if name not in EXAMPLES:
            raise BadInputError(f"{path}: examples: {unknown('example', name, EXAMPLES)}")
        sizes = study.sizes.get(name, (None,)) if isinstance(study.sizes, dict) else study.sizes or (None,)
        for size in sizes:
            given = {} if size is None else {"n": size}
            try:
                problem = EXAMPLES[name](**given)
            except (ValueError, MemoryError) as error:
                raise BadInputError(f"{path}: sizes: {error}") from error
            content = {"kind": "example", "example": name, "quadrature": study.quadrature, **given}
            yield content, name, name, problem.size
    for text in study.files:
        file = path.parent / text
        yield _file_problem(file), load_problem(file).name, Path(text).stem, ""
    if study.random is not None:
        kinds = list(study.random.kinds)
        for number in range(study.random.seed, study.random.seed + study.random.count):
            kind = kinds[number % len(kinds)]
            content = {"kind": "random", "seed": number, "of": kind}
            yield content, f"random-{number}", f"random {kind}", ""


def _file_problem(file: Path) -> Problem:
    """A problem file with a digest of it and of its mesh file."""
    table = read_table(file)
    parts = [file.read_bytes()]
    if table.mesh.file is not None:
        parts.append((file.parent / table.mesh.file).read_bytes())
    digest = hashlib.sha256(b"\0".join(parts)).hexdigest()
    return {"kind": "file", "digest": digest, "path": str(file.resolve())}
