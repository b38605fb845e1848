"""What is to be solved: pairs of problems and formulations with their options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from rmesh_nlp.errors import BadInputError, unknown
from rmesh_nlp.examples import EXAMPLES, Delta, Size
from rmesh_nlp.examples.reference import with_reference
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.io.files import safe_name
from rmesh_nlp.io.records import Record
from rmesh_nlp.models.outer_solvers import OUTER_SOLVERS
from rmesh_nlp.mpcc import RELAXATIONS
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.formulation import Chooser, Formulation, find
from rmesh_nlp.solving.options import accepted
from rmesh_nlp.study.file_cases import SUFFIX, own_problems, refinements

FLAGS = {"time_limit_s": "--time-limit", "max_iterations": "--max-iterations", "tolerance": "--tolerance"}
"""Limits: who does not heed one is finite without it. Their names on the command line."""


RELOCATING_NOTHING = "fixed"
"""The formulation that solves on the mesh as it is."""


@dataclass(frozen=True)
class Case:
    """One solve to be done.

    Attributes
    ----------
    problem : ContactProblem
    formulation : str
        Name of an installed formulation.
    options : mapping
        Of :func:`rmesh_nlp.solving.driver.solve_by_options`: ``objective``, ``relaxation``, ``seed``, ...
    certify : bool
        Whether to bound the error of the solution.
    repeats : int
        How often it is solved, for its times.
    trace : bool
        Whether to measure the first-order residual along the solve, once it has ended.
    made : Formulation or Chooser, optional
        An object in the place of the installed formulation; ``formulation`` is then what rows call it.
    """

    problem: ContactProblem
    formulation: str
    options: Mapping[str, Any] = field(default_factory=dict)
    certify: bool = False
    repeats: int = 1
    trace: bool = False
    made: Formulation | Chooser | None = None

    @property
    def key(self) -> str:
        """A name for files, such as ``6.2-12x6-joint`` or ``6.1-8-mpcc-seed3``."""
        options = [
            f"{name}{value}" if isinstance(value, (int, float)) else str(value)
            for name, value in sorted(self.options.items())
        ]
        parts = [self.problem.name, self.problem.size, self.formulation, *options]
        return safe_name("-".join(part for part in parts if part))

    @property
    def identity(self) -> Record:
        """The entries of the record that say which solve it is."""
        return {
            "key": self.key,
            "example": self.problem.name,
            "formulation": self.formulation,
            "n": self.problem.size,
            "delta": self.problem.motion.delta_record(),
            "quadrature": self.problem.rule,
        }


def plan_comparison(
    examples: Sequence[str],
    formulations: Sequence[str],
    *,
    n: Size | None = None,
    delta: Delta | None = None,
    quadrature: str | int = "midpoint",
    options: Mapping[str, Any] | None = None,
    certify: bool = False,
    refined: int | None = None,
    repeats: int = 1,
    trace: bool = False,
) -> list[Case]:
    """All pairs of examples and formulations, with the same settings.

    An option goes to those formulations that take it; of ``objective`` and ``seed`` there may be several, as
    lists. A formulation may have options of its own, see :func:`formulation_options`. Of a problem file,
    whose name ends with ``.toml``, also uniform refinements without motion are cases: ``refined`` of them,
    see :func:`rmesh_nlp.study.file_cases.refinements`.

    Raises
    ------
    BadInputError
        If a name is unknown, a setting does not suit an example, or no formulation takes an option.
    """
    options = dict(options or {})
    _check_options(options)
    own = own_problems(examples)
    if own and (n is not None or delta is not None or quadrature != "midpoint"):
        raise BadInputError("size, delta and quadrature are for the examples: write them into the files")
    problems = own + [
        build_problem(name, n=n, delta=delta, quadrature=quadrature)
        for name in examples
        if not name.endswith(SUFFIX)
    ]
    objectives = as_list(options.get("objective", "energy"))
    errors = [text for text in objectives if parse_objective(text).needs_exact]
    if errors and own:
        raise BadInputError(
            f"--objective {errors[0]}: needs an exact or reference solution, and {own[0].name!r} has none"
        )
    if errors:
        problems = [with_reference(problem) for problem in problems]
    chosen = [formulation_options(text) for text in formulations]
    for _, own_options in chosen:
        _check_options(own_options)
    taken = {name: accepted(name, options) for name, _ in chosen}
    for option in options:
        if option not in FLAGS and not any(option in names for names in taken.values()):
            raise BadInputError(f"--{option} {options[option]}: not an option of {', '.join(formulations)}")
    finer = [
        Case(fine, RELOCATING_NOTHING, certify=certify)
        for problem in own
        for fine in refinements(problem, refined)
    ]
    several = {option: as_list(options[option]) for option in ("objective", "seed") if option in options}
    commons = [{**options, **dict(zip(several, one, strict=True))} for one in product(*several.values())]
    cases = [
        Case(
            problem,
            name,
            {**{key: common[key] for key in common if key in taken[name]}, **own},
            certify,
            repeats,
            trace,
        )
        for problem in problems
        for common in commons
        for name, own in chosen
    ]
    if len(commons) > 1:  # a formulation that takes no seed would be solved once for each of them
        cases = list({case.key: case for case in cases}.values())
    return cases + finer


def formulation_options(text: str) -> tuple[str, dict[str, Any]]:
    """A formulation with options of its own, ``mpcc:start=joint`` or ``nested:outer=ipopt:seed=3``.

    Raises
    ------
    BadInputError
        If an option has no value, or the formulation does not take it.
    """
    name, *parts = text.split(":")
    find(name)
    found: dict[str, Any] = {}
    for part in parts:
        key, given, value = part.partition("=")
        if not given or not value:
            raise BadInputError(f"{text!r}: an option is written name=value, got {part!r}")
        if key not in accepted(name, [key]):
            raise BadInputError(f"{text!r}: {name} takes no option {key!r}")
        found[key] = int(value) if value.isdecimal() else value
    return name, found


def as_list(value: Any) -> list[Any]:
    """Several values as a list, one as a list of one."""
    return list(value) if isinstance(value, (list, tuple)) else [value]


def build_problem(
    name: str, *, n: Size | None = None, delta: Delta | None = None, quadrature: str | int = "midpoint"
) -> ContactProblem:
    """An example by name; by default of the paper's size.

    Raises
    ------
    BadInputError
        If the name is unknown or the example refuses the size or the delta.
    """
    if name not in EXAMPLES:
        raise unknown("example", name, EXAMPLES)
    given = {key: value for key, value in (("n", n), ("delta", delta)) if value is not None}
    try:
        return replace(EXAMPLES[name](**given), quadrature=quadrature)
    except (ValueError, MemoryError) as error:
        raise BadInputError(str(error)) from error


def _check_options(options: Mapping[str, Any]) -> None:
    if "objective" in options:
        try:
            for text in as_list(options["objective"]):
                parse_objective(text)
        except ValueError as error:
            raise BadInputError(str(error)) from error
    if options.get("relaxation", "scholtes") not in RELAXATIONS:
        raise unknown("relaxation", options["relaxation"], RELAXATIONS)
    if options.get("outer", "newton") not in OUTER_SOLVERS:
        raise unknown("outer solver", options["outer"], OUTER_SOLVERS)
