"""What a formulation is, and the installed ones by name; docs/own_formulation.md shows how to write one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any, ClassVar, TypeAlias

from rmesh_nlp.errors import BadInputError, nearest, unknown
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.optimize.budget import Limits
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.settings import ByName, Limit, Part, Settings, Values
from rmesh_nlp.solving.monitor import Monitor
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer

GROUP = "rmesh_nlp.formulations"
WRAPPERS = "rmesh_nlp.wrappers"
"""Entry points of formulations that take one, by the option that asks for them."""

GIVEN = "given"
"""The start that names no formulation."""

NEEDLESS = ("tolerance", "limits")
"""Options that a formulation which moves nothing does not need, ..."""

KEYWORDS = ("objective", "audit", "start", "seed", *NEEDLESS)
"""... and all that are keywords of :func:`rmesh_nlp.solving.driver.solve`; others are settings."""

ACCURACY = ("accuracy", "quantities", "guaranteed", "own_order")
"""Options that ask for ``adaptive`` around the formulation that is named; ``auto`` is ``fixed`` then."""

INSIDE_OUT = ("regularisation", "remesh", "starts")
"""Which of these options is meant of what: of several starts each one takes the whole schedule of weights."""


@dataclass(frozen=True)
class Keywords(Settings):
    """Keywords of a solve that are numbers or flags."""

    tolerance: Part | None = None
    seed: Limit | None = None
    audit: bool = True


@dataclass(frozen=True)
class Formulation(Settings, ABC):
    """One way to place the nodes."""

    relocates: ClassVar[bool] = True
    """Whether nodes move at all; if not, there is nothing to be stationary in."""

    takes_steps: ClassVar[bool] = False
    """Whether load steps are solved one after the other."""

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        """Raise if it does not take a problem or an objective.

        Raises
        ------
        BadInputError
        """

    def choose(self, problem: ContactProblem, objective: Objective, *, is_started: bool = False) -> Choice:
        """Itself, without a reason; see :meth:`Chooser.choose`."""
        return Choice(self, problem, "")

    @abstractmethod
    def run(self, outer: Outer, q: Array, monitor: Monitor) -> Outcome:
        """Minimise from outer variables ``q`` (n,).

        Every NLP that it solves reports its iterates to ``monitor.track(outer)``. What a limit or Ctrl-C
        ends needs no care: the best valid outer variables that were reported are the outcome then.
        """

    @property
    def name(self) -> str:
        """What the record calls it: that of its entry point."""
        return name_of(type(self))


@dataclass(frozen=True)
class Wrapper(Formulation):
    """A formulation that takes one, ``inner``; what a chooser chooses takes its place before it runs."""

    inner: Any

    begins_by_itself: ClassVar[tuple[str, ...]] = ()
    """Options of where to start that it leaves no room for."""

    def accepts(self, problem: ContactProblem, objective: Objective) -> None:
        """As what it takes does."""
        self.inner.accepts(problem, objective)

    def choose(self, problem: ContactProblem, objective: Objective, *, is_started: bool = False) -> Choice:
        """Around what is chosen for ``inner``."""
        choice: Choice = self.inner.choose(problem, objective, is_started=is_started)
        return replace(choice, formulation=replace(self, inner=choice.formulation))

    @property
    def name(self) -> str:
        """That of what it takes."""
        return str(self.inner.name)


@dataclass(frozen=True)
class Choice:
    """A formulation, why, and the problem as it is to be solved, perhaps by other rules."""

    formulation: Formulation
    problem: ContactProblem
    why: str


@dataclass(frozen=True)
class Chooser(Settings, ABC):
    """What chooses a formulation for a problem; its fields are what may be asked of the choice."""

    @property
    def name(self) -> str:
        """That of its entry point."""
        return name_of(type(self))

    @abstractmethod
    def choose(self, problem: ContactProblem, objective: Objective, *, is_started: bool = False) -> Choice:
        """A formulation, and why; ``is_started`` if a start is given that must not be left."""


Asked: TypeAlias = str | Formulation | Chooser
"""A formulation by its name, or an object whose fields are its settings."""


def available(group: str = GROUP) -> Mapping[str, EntryPoint]:
    """Installed formulations, or those of ``WRAPPERS``, by name; nothing is imported yet."""
    return _entries(entry_points, group)


@lru_cache
def _entries(found: Callable[..., Iterable[EntryPoint]], group: str) -> Mapping[str, EntryPoint]:
    """Looked for once: it reads the metadata of every installed package, which takes ten contact solves."""
    return MappingProxyType({entry.name: entry for entry in found(group=group)})


def formulations() -> tuple[str, ...]:
    """Names of the installed formulations, those of other packages included."""
    return tuple(sorted(available()))


def find(name: str, group: str = GROUP) -> Any:
    """The class or the choosing function of a name; a BadInputError if there is none, or no such module."""
    installed = available(group)
    if name not in installed:
        raise unknown("formulation", name, installed)
    try:
        return installed[name].load()
    except (ImportError, AttributeError) as error:
        said = f"formulation {name!r} cannot be loaded from {installed[name].value}: {error}"
        raise BadInputError(said) from error


def name_of(kind: type[Any], group: str = GROUP) -> str:
    """The name of an entry point of a class; that of the class where it has none."""
    value = f"{kind.__module__}:{kind.__qualname__}"
    names = [name for name, entry in available(group).items() if entry.value == value]
    return names[0] if names else kind.__name__.lower()


def kind_of(formulation: Asked) -> type[Formulation | Chooser]:
    """The class of a formulation, given by its name or by an object."""
    kind = find(formulation) if isinstance(formulation, str) else type(formulation)
    if not (isinstance(kind, type) and issubclass(kind, (Formulation, Chooser))):
        raise BadInputError(f"formulation must be a name or an object of a formulation, got {formulation!r}")
    return kind


def options(formulation: Asked) -> set[str]:
    """Names of the options that a formulation takes, wherever they are given.

    They are keywords of :func:`rmesh_nlp.solving.driver.solve` and, of a formulation by name, its settings
    and those of ``WRAPPERS``.
    """
    kind, is_named = kind_of(formulation), isinstance(formulation, str)
    names = {"objective", "audit", *((*kind.names(), *ACCURACY) if is_named else ())}
    if getattr(kind, "relocates", True):
        names |= {*KEYWORDS, *(available(WRAPPERS) if is_named else ())}
    return names


def taken(formulation: Asked, given: ByName) -> Values:
    """Those of some options that a formulation takes."""
    accepted = options(formulation)
    return {name: value for name, value in given.items() if name in accepted}


def check_taken(given: ByName, formulations: Sequence[Asked]) -> None:
    """Raise a BadInputError for an option that none of several formulations takes."""
    accepted = {name for formulation in formulations for name in (*NEEDLESS, *options(formulation))}
    for name, value in given.items():
        if name not in accepted:
            names = ", ".join(one if isinstance(one, str) else one.name for one in formulations)
            near = nearest(name, sorted(accepted))
            raise BadInputError(f"{name} = {value!r} is not an option of {names}{near}", name)


def checked(formulation: str, given: ByName) -> Values:
    """Options of a formulation, if it takes each of them and its value can be meant; else a BadInputError."""
    check_start(composed(formulation, given), given)
    first(given.get("start"))
    Keywords(given.get("tolerance"), given.get("seed"), given.get("audit", True))
    Limits.of(given.get("limits"))
    parse_objective(given.get("objective", "energy"))
    return dict(given)


def check_start(asked: Formulation | Chooser, given: ByName) -> None:
    """Raise a BadInputError where a start is given and a formulation makes its own."""
    if isinstance(asked, Wrapper):
        name = name_of(type(asked), WRAPPERS)
        for option in asked.begins_by_itself:
            if given.get(option) is not None:
                raise BadInputError(f"{name} cannot be combined with {option}: it begins by itself")
        check_start(asked.inner, {**given, name: True})


def composed(formulation: Asked, given: ByName) -> Formulation | Chooser:
    """A formulation by name with settings, within those that other options ask for.

    Options are settings of the formulation, and names of ``WRAPPERS``, each with what it is to do, or False;
    ``KEYWORDS`` of a solve have no part in it. None is a default. A BadInputError names an option that the
    formulation does not take.
    """
    kind, wrappers = kind_of(formulation), available(WRAPPERS)
    asked = {k: v for k, v in given.items() if v is not None and not (v is False and k in wrappers)}
    if not isinstance(formulation, str):
        if asked:
            example = f"{type(formulation).__name__}({next(iter(asked))}=...)"
            raise BadInputError(f"settings are fields of the formulation: {example}")
        return formulation
    check_taken(asked, [formulation])
    own = kind.names()
    if asked.keys() & set(ACCURACY) - own.keys():
        settings = {key: asked.pop(key) for key in ACCURACY if key in asked}
        inner = composed("fixed" if formulation == "auto" else formulation, asked)
        return composed("adaptive", {**settings, "inner": inner})
    made = kind().having({key: value for key, value in asked.items() if key in own})
    around = [key for key in asked if key in wrappers]
    for key in sorted(around, key=(*INSIDE_OUT, *around).index):
        made = find(key, WRAPPERS)(made, asked[key])
    return made


def first(start: object) -> Formulation | None:
    """The formulation that a start names, which runs before; None where it names none."""
    if not isinstance(start, str) or start == GIVEN:
        return None
    named = composed(start, {}) if start in available() else None
    if not isinstance(named, Formulation):  # what chooses among others is none
        names = [name for name in sorted(available()) if isinstance(composed(name, {}), Formulation)]
        raise unknown("start", start, [GIVEN, *names])
    return named
