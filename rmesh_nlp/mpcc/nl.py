"""The text form of AMPL's ``.nl`` files, with complementarity rows.

D. M. Gay, Writing .nl files, Sandia report 2005-7907P. A row with bound type 5, ``5 k i``, complements the
unknown i - 1: bit 1 of k says that its lower bound takes part, bit 2 its upper bound. The row is non-negative
where the unknown is at its lower bound, non-positive at its upper bound, zero between; CasADi's own
importer refuses such rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

_UNARY: dict[int, Callable[..., Any]] = {
    13: ca.floor, 14: ca.ceil, 15: ca.fabs, 16: lambda a: -a, 34: ca.logic_not, 37: ca.tanh, 38: ca.tan,
    39: ca.sqrt, 40: ca.sinh, 41: ca.sin, 42: ca.log10, 43: ca.log, 44: ca.exp, 45: ca.cosh, 46: ca.cos,
    47: ca.atanh, 49: ca.atan, 50: ca.asinh, 51: ca.asin, 52: ca.acosh, 53: ca.acos, 76: lambda a: a * a,
}  # fmt: skip
_BINARY: dict[int, Callable[..., Any]] = {
    0: lambda a, b: a + b, 1: lambda a, b: a - b, 2: lambda a, b: a * b, 3: lambda a, b: a / b,
    4: ca.remainder, 5: lambda a, b: a**b, 6: lambda a, b: ca.fmax(a - b, 0), 20: ca.logic_or,
    21: ca.logic_and, 22: lambda a, b: a < b, 23: lambda a, b: a <= b, 24: lambda a, b: a == b,
    28: lambda a, b: a >= b, 29: lambda a, b: a > b, 30: lambda a, b: a != b, 48: ca.atan2,
    75: lambda a, b: a**b, 77: lambda a, b: a**b,
}  # fmt: skip
_NARY: dict[int, Callable[..., Any]] = {
    11: lambda *parts: _fold(ca.fmin, parts),
    12: lambda *parts: _fold(ca.fmax, parts),
    54: lambda *parts: _fold(lambda a, b: a + b, parts),
}
_TERNARY: dict[int, Callable[..., Any]] = {35: ca.if_else}


def _fold(operation: Callable[[Any, Any], Any], parts: Sequence[Any]) -> Any:
    """Combine pairwise, so that long sums do not make deep graphs."""
    while len(parts) > 1:
        paired = [operation(a, b) for a, b in zip(parts[::2], parts[1::2], strict=False)]
        parts = paired + ([parts[-1]] if len(parts) % 2 else [])
    return parts[0]


@dataclass
class Rows:
    """A ``.nl`` file as read.

    Attributes
    ----------
    x : SX
    bodies : list of SX
        Constraint bodies, linear parts included.
    lower, upper : arrays
        Bounds of the rows.
    complements : dict
        Row to (bits k, unknown).
    lbx, ubx, x0 : arrays
    f : SX
        The first objective as written.
    maximise : bool
    """

    x: Any
    bodies: list[Any]
    lower: Any
    upper: Any
    lbx: Any
    ubx: Any
    x0: Any
    f: Any
    maximise: bool = False
    complements: dict[int, tuple[int, int]] = field(default_factory=dict)


class _Lines:
    """The lines of the file without comments; errors name the line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data = path.read_bytes()
        if data[:1] == b"b":
            raise ValueError(f"{path}: binary .nl files are not read; write the text form (option 'g')")
        if data[:1] != b"g":
            raise ValueError(f"{path}: not an .nl file, it must begin with 'g'")
        self._lines = data.decode("utf-8", errors="replace").splitlines()
        self.number = 0

    def next(self) -> str:
        while self.number < len(self._lines):
            line = self._lines[self.number].split("#", 1)[0].strip()
            self.number += 1
            if line:
                return line
        raise ValueError(f"{self.path}: the file ends too early")

    def more(self) -> bool:
        return any(line.split("#", 1)[0].strip() for line in self._lines[self.number :])

    def fault(self, what: str) -> ValueError:
        return ValueError(f"{self.path}, line {self.number}: {what}")

    def numbers(self, n: int) -> Iterator[list[str]]:
        for _ in range(n):
            yield self.next().split()


def read_rows(path: Path) -> Rows:
    """Read the text form of a ``.nl`` file.

    Raises
    ------
    ValueError
        With the file and line, if it is malformed, has integer unknowns, imported functions or logical rows.
    """
    lines = _Lines(path)
    try:
        return _read(lines)
    except (IndexError, KeyError, RuntimeError, TypeError) as error:
        raise lines.fault(f"malformed ({type(error).__name__}: {error})") from error
    except ValueError as error:
        raise (error if str(path) in str(error) else lines.fault(str(error))) from error


def _read(lines: _Lines) -> Rows:
    header = [lines.next().split() for _ in range(10)]
    n, m = int(header[1][0]), int(header[1][1])
    if any(int(count) for count in header[6][:5]):
        raise lines.fault("integer unknowns are not supported")
    if min(n, m) < 0 or max(n, m) > 10_000_000:
        raise lines.fault(f"{n} unknowns and {m} rows")
    x = ca.SX.sym("x", n)
    values: list[Any] = ca.vertsplit(x) if n else []
    rows = Rows(
        x, [ca.SX(0)] * m, np.full(m, -np.inf), np.full(m, np.inf), np.full(n, -np.inf), np.full(n, np.inf),
        np.zeros(n), ca.SX(0),
    )  # fmt: skip
    while lines.more():
        head = lines.next()
        _segment(lines, rows, values, head[0], head[1:].split())
    return rows


def _segment(lines: _Lines, rows: Rows, values: list[Any], key: str, words: list[str]) -> None:
    n, m = int(rows.x.shape[0]), len(rows.bodies)
    match key:
        case "C":
            rows.bodies[_place(words[0], m)] += _expression(lines, values)
        case "O":
            expression = _expression(lines, values)
            if int(words[0]) == 0:
                rows.f += expression
                rows.maximise = int(words[1]) == 1
        case "V":
            terms = [(int(i), float(c)) for i, c in lines.numbers(int(words[1]))]
            value = sum((c * values[i] for i, c in terms), ca.SX(0)) + _expression(lines, values)
            if int(words[0]) != len(values):
                raise lines.fault(f"defined variable v{words[0]} out of order")
            values.append(value)
        case "x":
            for i, value in lines.numbers(int(words[0])):
                rows.x0[_place(i, n)] = float(value)
        case "r":
            for row in range(m):
                rows.lower[row], rows.upper[row] = _bound(lines, rows, row)
        case "b":
            for j in range(n):
                rows.lbx[j], rows.ubx[j] = _bound(lines, None, j)
        case "J" | "G":
            terms = [(_place(i, n), float(c)) for i, c in lines.numbers(int(words[1]))]
            used = [c * values[i] for i, c in terms if c]
            linear = _fold(lambda a, b: a + b, used) if used else 0
            if key == "J":
                rows.bodies[_place(words[0], m)] += linear
            elif int(words[0]) == 0:
                rows.f += linear
        case "k" | "d" | "S":
            for _ in lines.numbers(int(words[1 if key == "S" else 0])):
                pass
        case "F":
            raise lines.fault("imported functions are not supported")
        case "L":
            raise lines.fault("logical rows are not supported")
        case _:
            raise lines.fault(f"unknown segment {key!r}")


def _place(word: str, n: int) -> int:
    i = int(word)
    if not 0 <= i < n:
        raise ValueError(f"index {i} out of range 0 to {n - 1}")
    return i


def _bound(lines: _Lines, rows: Rows | None, i: int) -> tuple[float, float]:
    """One line of the r or b segment; complementarity is noted in ``rows``."""
    kind, *words = lines.next().split()
    match int(kind):
        case 0:
            return float(words[0]), float(words[1])
        case 1:
            return -np.inf, float(words[0])
        case 2:
            return float(words[0]), np.inf
        case 3:
            return -np.inf, np.inf
        case 4:
            return float(words[0]), float(words[0])
        case 5 if rows is not None:
            rows.complements[i] = int(words[0]), _place(str(int(words[1]) - 1), int(rows.x.shape[0]))
            return -np.inf, np.inf
    raise lines.fault(f"unknown bound type {kind}")


def _expression(lines: _Lines, values: list[Any]) -> Any:
    """One expression in prefix form, with a stack of its own: sums may be thousands of levels deep."""
    pending: list[tuple[Callable[..., Any], int, list[Any]]] = []
    while True:
        line = lines.next()
        kind, rest = line[0], line[1:]
        value: Any = None
        match kind:
            case "n" | "s" | "l":
                value = ca.SX(float(rest))
            case "v":
                value = values[_place(rest, len(values))]
            case "o":
                pending.append((*_operation(lines, int(rest)), []))
                continue
            case _:
                raise lines.fault(f"unknown expression {line!r}")
        while pending:
            operation, count, arguments = pending[-1]
            arguments.append(value)
            if len(arguments) < count:
                break
            pending.pop()
            value = operation(*arguments)
        else:
            return value


def _operation(lines: _Lines, code: int) -> tuple[Callable[..., Any], int]:
    """An operation and the number of its arguments."""
    for count, operations in ((1, _UNARY), (2, _BINARY), (3, _TERNARY)):
        if code in operations:
            return operations[code], count
    if code not in _NARY:
        raise lines.fault(f"operation o{code} is not supported")
    count = int(lines.next())
    if count < 1:
        raise lines.fault(f"an operation on {count} terms")
    return _NARY[code], count
