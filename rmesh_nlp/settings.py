"""Numeric choices as data: frozen dataclasses whose fields are documented and checked."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from functools import cache
from numbers import Integral, Real
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from rmesh_nlp.errors import BadInputError, require, unknown

ByName = Mapping[str, Any]
"""Values of any kind by their names: options, settings, the entries of a table."""

Values = dict[str, Any]
"""The same, to be added to."""

S = TypeVar("S", bound="Settings")


def real(name: str, value: Any) -> float:
    """A real number of any type, or an array without dimensions, as a float; a BadInputError for all else."""
    one = value.item() if getattr(value, "shape", None) == () else value
    require(isinstance(one, Real) and not isinstance(one, bool), name, "be a number", value)
    return float(one)


@dataclass(frozen=True)
class Number:
    """What a number may be: finite, above ``above`` and below ``below``.

    With ``least`` it is an int of at least that, not a float that happens to be whole. Infinity may be too if
    ``infinite``, such as for a limit that is none.
    """

    above: float = 0.0
    below: float = math.inf
    least: int | None = None
    infinite: bool = False

    def check(self, name: str, value: Any) -> None:
        """Raise a BadInputError that names the value if it is not such a number."""
        number = isinstance(value, Real) and not isinstance(value, bool)
        if self.least is not None:
            is_whole = number and isinstance(value, Integral) and int(value) >= self.least
            require(is_whole, name, f"be a whole number of at least {self.least}", value)
        elif not (self.infinite and value == math.inf):
            require(number and 0 < value < math.inf, name, "be positive and finite", value)
            require(value > self.above, name, f"be above {self.above:g}", value)
            require(value < self.below, name, f"be below {self.below:g}", value)


Positive = Annotated[float, Number()]
Part = Annotated[float, Number(below=1.0)]
Factor = Annotated[float, Number(above=1.0)]
Count = Annotated[int, Number(least=1)]
Limit = Annotated[int, Number(least=0)]
Seconds = Annotated[float, Number(infinite=True)]


@dataclass(frozen=True)
class Open:
    """Mark of a field that holds settings, or a mapping of some: their names may be given in its place.

    None of them may be among those that are ``closed``.
    """

    kind: type[Settings]
    closed: tuple[str, ...] = ()

    def check(self, name: str, value: object) -> None:
        """Raise a BadInputError if a mapping has other names."""
        if isinstance(value, Mapping):
            self.kind().having(value)
            for one in self.closed:
                if one in value:
                    raise BadInputError(f"{name} may not have {one}, got {value[one]!r}")


class Checked:
    """Base of a dataclass whose fields are what their types say, such as ``Positive``."""

    def __post_init__(self) -> None:
        for name, kind in self._kinds().items():
            _check(name, getattr(self, name), kind)

    @classmethod
    @cache
    def _kinds(cls) -> Values:
        hints = get_type_hints(cls, include_extras=True)
        return {field.name: hints[field.name] for field in fields(cls)}  # type: ignore[arg-type]


@dataclass(frozen=True)
class Settings(Checked):
    """Base of the settings of a method.

    A subclass is a frozen dataclass all of whose fields have defaults, each documented with its source
    or with the benchmark that chose it. A field's type says what it may be: one of the types of number
    above, by itself, in a tuple, or as an alternative to None; or settings themselves. Only what concerns
    several fields is left to the subclass.
    """

    @classmethod
    def of(cls: type[S], given: Settings | Mapping[str, object] | None) -> S:
        """Settings from an instance, from a mapping of the fields that differ, or the defaults."""
        if given is None:
            return cls()
        if isinstance(given, cls):
            return given
        if not isinstance(given, Mapping):
            name = cls.__name__
            said = f"{name.lower()} must be {name} or a mapping of its fields, got {given!r}"
            raise BadInputError(said, name.lower())
        return cls().having(given)

    @classmethod
    def names(cls) -> dict[str, str]:
        """What may be given by name, and the field that it is for: fields, and names of open ones."""
        names = {name: name for name in cls._kinds()}
        for place, kind in cls._kinds().items():
            for mark in (mark for mark in get_args(kind)[1:] if isinstance(mark, Open)):
                open_names = (name for name in mark.kind.names() if name not in mark.closed)
                names = {**dict.fromkeys(open_names, place), **names}
        return names

    def having(self: S, given: ByName) -> S:
        """These settings with other values by :meth:`names`; a BadInputError if there is no such name."""
        places, values = self.names(), Values()
        for name, value in given.items():
            if name not in places:
                raise unknown("setting", name, sorted(places))
            place = places[name]
            now = values.get(place, getattr(self, place))
            inner = value if place == name else {name: value}
            if isinstance(now, Settings) and isinstance(inner, Mapping):
                values[place] = now.having(inner)
            else:
                values[place] = inner if place == name else {**now, **inner}
        return replace(self, **values)

    def changed(self) -> Values:
        """The fields that differ from their defaults, as plain values."""
        found: Values = {}
        for field in fields(self):
            value: Any = getattr(self, field.name)
            default = field.default if field.default_factory is MISSING else field.default_factory()
            if isinstance(value, Settings):
                plain: Any = value.changed()
            else:
                plain = dict(value) if isinstance(value, Mapping) else value
            if value != default and plain != {}:
                found[field.name] = plain
        return found


def from_texts(given: Iterable[str], where: str = "--set ") -> Values:
    """Settings from texts ``name=value`` or ``outer.name=value``; a value is JSON, or else a text."""
    found: Values = {}
    for text in given:
        names, equals, value = text.partition("=")
        *outer, name = (part.strip() for part in names.split("."))
        if not (equals and name and all(outer)):
            raise BadInputError(f"{where}must be NAME=VALUE, got {text!r}")
        table = found
        for part in outer:
            table = table.setdefault(part, {})
            if not isinstance(table, dict):
                raise BadInputError(f"{where}{text}: {part} has a value already, {table!r}")
        try:
            table[name] = json.loads(value)
        except ValueError:
            table[name] = value.strip()
    return found


WORDS: Mapping[object, str] = {
    bool: "true or false",
    str: "a name",
    Mapping: "a mapping from names to values",
}


def _check(name: str, value: Any, kind: Any) -> None:
    """Raise a BadInputError if a value is not what the type of its field says, beyond what Python's says."""
    plain = get_origin(kind) or kind
    if plain is Annotated:
        base, *rules = get_args(kind)
        _check(name, value, base)
        for rule in rules:
            rule.check(name, value)
    elif type(None) in get_args(kind):
        if value is not None:
            _check(name, value, get_args(kind)[0])
    elif plain is tuple and get_origin(get_args(kind)[0]) is Annotated:
        require(isinstance(value, (tuple, list)) and value, name, "be one or more numbers", value)
        for one in value:
            _check(name, one, get_args(kind)[0])
    elif plain in WORDS:
        require(isinstance(value, plain), name, f"be {WORDS[plain]}", value)
    elif isinstance(kind, type) and issubclass(kind, Settings):
        require(isinstance(value, kind), name, "be settings of the method, or a mapping", value)


def check_positive(**values: float) -> None:
    """Raise a BadInputError for a value that is not positive and finite."""
    for name, value in values.items():
        Number().check(name, value)
