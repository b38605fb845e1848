"""Planned solves: problem, formulation, options and key, and the plan that a study file asks for."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

from rmesh_nlp import __version__
from rmesh_nlp.errors import BadInputError, located
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.paper import RULES
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.examples.reference import with_reference
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.io.folder import safe_name
from rmesh_nlp.io.problem_file import load_problem, read_table
from rmesh_nlp.io.records import Record, Records
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import ByName, Values
from rmesh_nlp.solving.formulation import Chooser, Formulation, checked, taken
from rmesh_nlp.study.study_file import StudyTable

LARGEST = 1_000_000  # solves of a study


@dataclass(frozen=True)
class PlannedSolve:
    """One solve to be done: of a study, of a comparison, or by itself.

    All but ``built`` and ``made`` are plain JSON values, which travel to other processes and machines.
    """

    problem: ByName  # kind (example, file, random) and what states it; empty where built is all
    name: str
    family: str  # of problems that summaries join
    size: str
    variant: str  # its name in a study; empty in a comparison
    formulation: str  # name of an installed one, or what rows call made
    options: ByName = field(default_factory=dict)  # of a solve: objective, seed, ...
    repeat: int = 0  # number of the repetition in a study
    time_s: float = math.inf  # limits, above which a process of its own is killed
    memory_mb: float = math.inf
    fields: bool = True  # meshes and fields are kept
    certify: bool = False
    repeats: int = 1  # solves for one row, whose times are then medians
    built: ContactProblem | None = field(default=None, repr=False)  # the problem itself, in this process
    made: Formulation | Chooser | None = None  # in the place of the installed formulation, in this process

    @property
    def order(self) -> int:
        """Of the displacements."""
        return int(self.problem.get("order", 1)) if self.built is None else self.built.order

    @property
    def key(self) -> str:
        """A file name: in a study with a digest of the content, else of names and options.

        The digest is of problem, variant, options, limits, repetition and version: the same solve has the
        same key anywhere. Keys of comparisons are such as ``6.2-12x6-joint`` or ``6.1-8-order2-mpcc-seed3``.
        """
        which = [self.name, self.size, f"order{self.order}" if self.order != 1 else ""]
        if not self.variant:
            options = [
                f"{name}{value}" if isinstance(value, (int, float)) else str(value)
                for name, value in sorted(_flat(self.options))
            ]
            return safe_name("-".join(filter(None, [*which, self.formulation, *options])))
        decisive = ("variant", "formulation", "options", "repeat", "certify", "time_s", "memory_mb")
        content = {
            "problem": {k: v for k, v in self.problem.items() if k != "path"},
            "version": __version__,
            **{name: getattr(self, name) for name in decisive},
        }
        digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
        stem = "-".join(filter(None, [*which, self.variant]))
        return safe_name(f"{stem[:100]}-{digest}")

    @property
    def identity(self) -> Record:
        """The entries of a row that say which solve it is."""
        entries: Record = {"key": self.key, "example": self.name, "formulation": self.formulation}
        if self.variant:
            entries |= {"family": self.family, "variant": self.variant, "repeat": self.repeat}
        entries["order"] = self.order
        if self.built is None:
            return {**entries, "n": self.size}
        motion, rule = self.built.motion.delta_record(), self.built.rule
        return {**entries, "n": self.built.size, "delta": motion, "quadrature": rule}

    def plain(self) -> Values:
        """What travels, by the names of the attributes."""
        kept = (attribute.name for attribute in fields(self) if attribute.name not in ("built", "made"))
        return {name: getattr(self, name) for name in kept}


def _flat(options: ByName) -> Iterator[tuple[str, Any]]:
    """Options and those inside of them."""
    for name, value in options.items():
        if isinstance(value, Mapping):
            yield from _flat(value)
        else:
            yield name, value


def planned(
    built: ContactProblem, formulation: str, options: ByName | None = None, **others: Any
) -> PlannedSolve:
    """A solve of a problem that is at hand, with other attributes by name."""
    about: Values = {"name": built.name, "family": built.name, "size": built.size, "built": built}
    about |= {"formulation": formulation, "options": options or {}}
    return PlannedSolve(**{"problem": {}, "variant": "", **about, **others})


def build(solve: PlannedSolve) -> ContactProblem:
    """The problem of a planned solve, with a reference solution if its objective needs one."""
    problem = _problem(solve.problem) if solve.built is None else solve.built
    objective = solve.options.get("objective", "energy")
    if solve.problem.get("kind") == "example" and parse_objective(objective).needs_exact:
        return with_reference(problem)
    return problem  # where nothing is known of the solution the formulation refuses such an objective


def _problem(stated: ByName) -> ContactProblem:
    if stated["kind"] == "example":
        return build_example(**{key: value for key, value in stated.items() if key != "kind"})
    if stated["kind"] == "file":
        return load_problem(stated["path"], stated.get("order"))
    if stated["kind"] == "random":
        problem = random_problem(stated["seed"], kind=stated["of"], order=stated.get("order", 1))
        return replace(problem, name=f"random-{stated['seed']}", size=f"{problem.mesh.nelements} triangles")
    raise ValueError(f"unknown kind of problem {stated['kind']!r}")


def build_example(example: str, quadrature: str | int | None = None, **given: Any) -> ContactProblem:
    """An example by name with ``n``, ``delta`` and ``order``, lists for pairs; by default the paper's."""
    try:
        problem = EXAMPLES[example](**given)
        return problem if quadrature is None else replace(problem, quadrature=quadrature)
    except (ValueError, MemoryError) as error:
        raise BadInputError(str(error)) from error


def make_plan(study: StudyTable, path: Path) -> list[PlannedSolve]:
    """All solves of a study, in the order: problem, variant, objective, seed, repetition.

    A study without ``objectives`` has those of its problem files. A formulation that takes no seed or no
    objective is solved once, not once for each. A BadInputError names what is unknown or broken, or the
    option that a formulation does not take.
    """
    stated = study.objectives
    variants = {stated: list(_variants(study, path, stated))}
    common: Values = {"time_s": study.limits.seconds, "memory_mb": study.limits.memory}
    common |= {"fields": study.fields, "certify": study.certify}
    problems, solves = list(_problems(study, path)), []
    if (count := len(problems) * len(variants[stated]) * study.repeats) > LARGEST:
        raise BadInputError(f"{path}: {count} solves: a study has at most {LARGEST}")
    for problem in problems:
        objectives = stated
        if problem[0]["kind"] == "file" and "objectives" not in study.model_fields_set:
            objectives = (read_table(problem[0]["path"]).solve.objective,)
        if objectives not in variants:
            variants[objectives] = list(_variants(study, path, objectives))
        solves += [
            PlannedSolve(*problem, variant, formulation, options, repeat, **common)
            for variant, formulation, options in variants[objectives]
            for repeat in range(study.repeats)
        ]
    return list({solve.key: solve for solve in solves}.values())


def _variants(study: StudyTable, path: Path, objectives: Sequence[str]) -> Iterator[tuple[str, str, Values]]:
    """Name, formulation and options of each for each objective and seed, also those that it does not take."""
    limits = {"seconds": study.limits.seconds, "iterations": study.limits.iterations}
    limits = {name: value for name, value in limits.items() if value is not None}
    for variant, table in study.formulations.items():
        formulation = table.formulation or variant
        for objective, seed in product(objectives, study.seeds):
            common: Values = {"limits": limits}
            common |= {} if objective == "energy" else {"objective": objective}
            common |= {} if seed == "given" else {"seed": seed}
            with located(f"{path}: formulations.{variant}"):
                options = checked(formulation, {**taken(formulation, common), **table.keywords})
            yield variant, formulation, options


def _problems(study: StudyTable, path: Path) -> Iterator[tuple[Values, str, str, str]]:
    """What states each problem, its name, family and size."""
    for name in study.examples:
        sizes = study.sizes.get(name, ()) if isinstance(study.sizes, dict) else study.sizes
        for size, order in product(sizes or (None,), study.order or (1,)):
            stated = {"kind": "example", "example": name, "order": order}
            stated |= {"quadrature": study.quadrature or RULES[order]} | ({} if size is None else {"n": size})
            with located(path):
                built = _problem(stated)
            yield stated, name, name, built.size
    for text in study.files:
        file = path.parent / text
        table = read_table(file)
        parts = [file.read_bytes()]
        if table.mesh.file is not None:
            parts.append((file.parent / table.mesh.file).read_bytes())
        digest = hashlib.sha256(b"\0".join(parts)).hexdigest()
        for order in study.order or (table.order,):
            stated = {"kind": "file", "digest": digest, "path": str(file.resolve()), "order": order}
            yield stated, load_problem(file, order).name, Path(text).stem, ""
    if (draws := study.random) is not None:
        for number in range(draws.seed, draws.seed + draws.count):
            kind = draws.kinds[number % len(draws.kinds)]
            for order in study.order or (1,):
                stated = {"kind": "random", "seed": number, "of": kind, "order": order}
                yield stated, f"random-{number}", f"random {kind}", ""


def seconds_of_plan(solves: Sequence[PlannedSolve], rows: Records) -> float:
    """Seconds that the solves take one after the other at most, by their limits, and roughly by these rows.

    A solve takes the median of those of its variant, family and order; none exceeds its limit.
    """
    measured: dict[tuple[str, str, int], list[float]] = {}
    for row in rows:
        if row.get("task_time_s") is not None:
            which = str(row.get("variant")), str(row.get("family")), row.get("order") or 1
            measured.setdefault(which, []).append(row["task_time_s"])
    alike = ((solve, measured.get((solve.variant, solve.family, solve.order))) for solve in solves)
    return sum(min(median(times or [math.inf]), solve.time_s) for solve, times in alike)
