"""Sizes, deltas, rules and lists as they are written on the command line.

Nothing heavy is imported here. What depends on the problem (an odd number of columns, say) is
checked by the problem itself.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any, Literal

from rmesh_nlp.errors import BadInputError

HIGHEST_DEGREE = 50
"""Rules above it have so many points that building the energy takes minutes."""


def parse_size(text: str) -> int | tuple[int, int]:
    """``8`` or ``12x6``, columns by rows."""
    if not re.fullmatch(r"[0-9]+([xX][0-9]+)?", text.strip()):
        raise BadInputError(f"--n must be a whole number or two like 12x6, got {text!r}")
    numbers = [int(part) for part in re.split("[xX]", text)]
    if min(numbers) < 2:
        raise BadInputError(f"--n must be at least 2 in each direction, got {text!r}")
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def parse_delta(text: str) -> float | tuple[float, float] | Literal["none"]:
    """``0.0275`` or ``0.15667,0.07333``, half-widths along x and y, or ``none``."""
    if text.strip() == "none":
        return "none"
    parts = text.split(",")
    if len(parts) > 2:
        raise BadInputError(f"--delta takes one number or two, got {len(parts)}: {text!r}")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        said = "--delta must be a number, two like 0.15667,0.07333, or none"
        raise BadInputError(f"{said}, got {text!r}") from None
    if not all(math.isfinite(number) and number > 0 for number in numbers):
        raise BadInputError(f"--delta must be positive and finite, got {text!r}")
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def parse_quadrature(text: str) -> str | int:
    """``midpoint`` or a degree."""
    if text == "midpoint":
        return text
    if not re.fullmatch("[0-9]+", text) or not 1 <= int(text) <= HIGHEST_DEGREE:
        raise BadInputError(
            f"--quadrature must be 'midpoint' or a degree from 1 to {HIGHEST_DEGREE}, got {text!r}"
        )
    return int(text)


def parse_seed(text: str) -> int:
    """A whole number that is not negative."""
    if not re.fullmatch("[0-9]+", text):
        raise BadInputError(f"--seed must be a whole number and not negative, got {text!r}")
    return int(text)


def parse_settings(given: list[str]) -> dict[str, Any]:
    """Settings of a formulation from texts ``name=value``; a value is JSON, or else a text.

    A setting of settings has the names of both: ``newton.forcing=0.2``.
    """
    found: dict[str, Any] = {}
    for text in given:
        names, equals, value = text.partition("=")
        *outer, name = (part.strip() for part in names.split("."))
        if not (equals and name and all(outer)):
            raise BadInputError(f"--set must be NAME=VALUE, got {text!r}")
        table = found
        for part in outer:
            table = table.setdefault(part, {})
            if not isinstance(table, dict):
                raise BadInputError(f"--set {text}: {part} has a value already, {table!r}")
        try:
            table[name] = json.loads(value)
        except ValueError:
            table[name] = value.strip()
    return found


def parse_weights(text: str | None) -> tuple[float, ...] | None:
    """``0.01`` or a schedule ``1,0.1,0.01``."""
    if text is None:
        return None
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = (math.nan,)
    if not all(math.isfinite(w) and w >= 0 for w in found) or 0 in found[:-1]:
        raise BadInputError(
            "--regularisation must be positive numbers such as 1,0.1,0.01, of which the last may be 0, "
            f"got {text!r}"
        )
    return found


def parse_names(option: str, text: str) -> tuple[str, ...]:
    """A list separated by commas, without repetitions, in the order given."""
    names = [part.strip() for part in text.split(",")]
    if not all(names):
        raise BadInputError(f"{option} must be names separated by commas, got {text!r}")
    return tuple(dict.fromkeys(names))
