"""What a program is given, checked at the door: lengths, numbers, bounds and symbols."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array


def checked(name: str, value: ArrayLike, n: int, what: str) -> Array:
    """Return ``value`` as a finite array of length ``n`` or say what is wrong with it."""
    array = np.array(numbers(name, value), dtype=float)
    array = np.full(n, float(array)) if array.ndim == 0 else array.ravel()
    if array.size != n:
        raise ValueError(f"{name} has length {array.size}, the problem has {n} {what}")
    if not np.all(np.isfinite(array)):
        i = int(np.flatnonzero(~np.isfinite(array))[0])
        raise ValueError(f"{name}[{i}] = {array[i]} is not finite")
    return array


def numbers(name: str, value: Any) -> Any:
    """``value`` as an array of numbers."""
    if isinstance(value, ca.DM):
        return value.full()
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{name} must be numeric, got {value!r}"[:300]) from error


def column(name: str, value: Any, kind: Any) -> Any:
    """``value`` (None, expression, number or list of them) as one column of ``kind``."""
    if value is None:
        return kind(0, 1) if kind is not None else None
    try:
        column = ca.vertcat(*value) if isinstance(value, (list, tuple)) else value
        if kind is not None:
            column = kind(0, 1) if isinstance(column, ca.DM) and column.is_empty() else kind(column)
    except (NotImplementedError, TypeError, RuntimeError) as error:
        raise ValueError(f"{name} must be a column of {kind.__name__ if kind else 'symbol'}s") from error
    if kind is None and type(column) not in (ca.SX, ca.MX):
        return column
    if column.is_empty():
        return type(column)(0, 1)
    if not column.is_column():
        if not column.is_row():
            raise ValueError(f"{name} must be a column, its shape is {column.shape}")
        column = column.T
    return column if name == "x" else ca.densify(column)


def bound(name: str, value: ArrayLike, n: int) -> Array:
    """``value`` as ``n`` bounds, infinite ones included; a scalar stands for all."""
    array = np.array(numbers(name, value), dtype=float)
    if array.ndim == 0:
        array = np.full(n, float(array))
    array = array.ravel()
    if array.size != n:
        raise ValueError(f"{name} has length {array.size}, expected {n}")
    if np.any(np.isnan(array)):
        raise ValueError(f"{name}[{int(np.flatnonzero(np.isnan(array))[0])}] is NaN")
    return array


def refuse_crossing(name: str, lower: Array, upper: Array) -> None:
    """Raise a ValueError for bounds between which there is no number."""
    wrong = np.flatnonzero((lower > upper) | (lower == np.inf) | (upper == -np.inf))
    if wrong.size:
        i = int(wrong[0])
        raise ValueError(
            f"lb{name}[{i}] = {lower[i]} and ub{name}[{i}] = {upper[i]} leave no value: "
            "the lower bound must not lie above the upper, and both cannot be the same infinity"
        )


def refuse_free_symbols(columns: dict[str, Any]) -> None:
    """Raise a ValueError for symbols that are neither unknowns nor parameters."""
    names = [name for name in ("f", "g", "G", "H") if columns[name].numel() > 0]
    try:
        oracle = ca.Function(
            "check", [columns["x"], columns["p"]], [columns[name] for name in names], {"allow_free": True}
        )
    except RuntimeError as error:  # the same symbol twice
        raise ValueError(f"x and p must be distinct symbols: {error}") from error
    if oracle.has_free():
        raise ValueError(f"free symbols {oracle.get_free()}: they are neither in x nor in p")
