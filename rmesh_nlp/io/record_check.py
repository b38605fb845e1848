"""What the entries of a record must be, so that tables and figures can rely on them."""

from __future__ import annotations

from typing import Any

TEXTS = ("example", "formulation", "objective", "n", "status")
COUNTS = ("iterations", "contact_solves", "seed")
NUMBERS = (
    "energy_initial",
    "energy",
    "energy_audited",
    "gain",
    "u_min",
    "u_max",
    "min_area_ratio",
    "wall_time_s",
    "contact_time_s",
    "equilibrium_residual",
    "complementarity_residual",
    "stationarity_residual",
)
MEASURED = tuple(name for name in (*NUMBERS, *COUNTS) if name not in ("stationarity_residual", "seed"))
"""Numbers that every successful solve has; other solves may have null."""


def fault(record: dict[str, Any]) -> str | None:
    """What is wrong with a record whose required entries are there, None if nothing is."""
    for name in TEXTS:
        if not isinstance(record.get(name), str):
            return f"{name!r} must be a text, not {record.get(name)!r}"
    if not isinstance(record.get("success"), bool):
        return f"'success' must be true or false, not {record.get('success')!r}"
    for name in (*NUMBERS, *COUNTS):
        value = record.get(name)
        if value is None and record["success"] and name in MEASURED:
            return f"{name!r} must be a number in a row of a success"
        if value is not None and not _is_number(value, whole=name in COUNTS):
            kind = "a whole number" if name in COUNTS else "a number"
            return f"{name!r} must be {kind} or null, not {value!r}"
    return None if _is_delta(record.get("delta")) else f"'delta' is no half-width: {record['delta']!r}"


def _is_number(value: Any, *, whole: bool = False) -> bool:
    return not isinstance(value, bool) and isinstance(value, int if whole else (int, float))


def _is_delta(delta: Any) -> bool:
    """None, two numbers, or a part of the local edge length."""
    if isinstance(delta, list):
        return len(delta) == 2 and all(map(_is_number, delta))
    return delta is None or (isinstance(delta, dict) and _is_number(delta.get("relative")))
