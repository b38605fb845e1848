"""Numeric choices as data: frozen dataclasses whose fields are documented and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields
from typing import Any, TypeVar

from rmesh_nlp.errors import BadInputError, unknown

S = TypeVar("S", bound="Settings")


@dataclass(frozen=True)
class Settings:
    """Base of the settings of a method.

    A subclass is a frozen dataclass all of whose fields have defaults, each documented with its source
    or with the benchmark that chose it. Fields may be settings themselves.
    """

    @classmethod
    def of(cls: type[S], given: Settings | Mapping[str, Any] | None) -> S:
        """Settings from an instance, from a mapping of the fields that differ, or the defaults.

        Raises
        ------
        BadInputError
            If there is no such field, or an instance is of another method.
        """
        if given is None:
            return cls()
        if isinstance(given, cls):
            return given
        if isinstance(given, Settings):
            raise BadInputError(f"expected settings of kind {cls.__name__}, got {type(given).__name__}")
        known = {field.name: field for field in fields(cls)}
        values = {}
        for name, value in given.items():
            if name not in known:
                raise unknown("setting", name, known)
            default = _default(known[name])
            inner = isinstance(default, Settings) and isinstance(value, Mapping)
            values[name] = type(default).of(value) if inner else value
        return cls(**values)

    def changed(self) -> dict[str, Any]:
        """The fields that differ from their defaults, as plain values."""
        found: dict[str, Any] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if value != _default(field):
                found[field.name] = value.changed() if isinstance(value, Settings) else _plain(value)
        return found


def _default(field: Field[Any]) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


def _plain(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else value


def check_positive(**values: float | None) -> None:
    """Raise a BadInputError for a value that is not positive and finite; None stands for a default."""
    for name, value in values.items():
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if value is not None and not (number and 0 < value < float("inf")):
            raise BadInputError(f"{name} must be positive and finite, got {value!r}")


def check_limits(*, tolerance: float, max_iterations: int | None, time_limit_s: float) -> None:
    """Raise a BadInputError for what no strategy takes as the tolerance or a limit of its solve."""
    check_positive(tolerance=tolerance, max_iterations=max_iterations, time_limit_s=time_limit_s)
    if max_iterations is not None and max_iterations != int(max_iterations):
        raise BadInputError(f"max_iterations must be a whole number, got {max_iterations!r}")
