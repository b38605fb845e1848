"""Records as lines of JSON: strict when written, and a line that was cut off is found when they are read."""

from __future__ import annotations

import json
import math
import os
import warnings
from pathlib import Path
from typing import Any

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.record_model import Record, read_record


class DamagedRecordsWarning(UserWarning):
    """A record that was not written to its end is passed over."""


def to_json(record: Record, indent: int | None = None) -> str:
    """Strict JSON: what is not a finite number becomes null, half a character a question mark."""
    return json.dumps(_plain(record), indent=indent, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):  # numpy scalars and arrays
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, str):
        return value.encode(errors="replace").decode()
    return value


def damaged_last_line(path: Path) -> tuple[int, bytes]:
    """How many bytes of a file of records are whole lines, and what stands behind them.

    A last line is damaged if it has no end, or if it begins like a record, or with a zero as after
    a power cut, and is not JSON.
    """
    if not path.exists():
        return 0, b""
    try:
        start, line = _last_line(path)
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror}") from error
    if line and (not line.endswith(b"\n") or (start and line[:1] in b"{\0" and not _is_json(line))):
        return start, line
    return start + len(line), b""


def _last_line(path: Path) -> tuple[int, bytes]:
    """Where the last line begins, and the line; only the end of the file is read."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        length = 4096
        while True:
            begin = max(0, size - length)
            file.seek(begin)
            tail = file.read()
            start = tail.rfind(b"\n", 0, max(len(tail) - 1, 0)) + 1
            if start or not begin:
                return begin + start, tail[start:]
            length *= 8


def _is_json(line: bytes) -> bool:
    try:
        json.loads(line)
    except (json.JSONDecodeError, UnicodeDecodeError):
        return False
    except (ValueError, RecursionError):
        pass  # JSON, if not ours: an error for the reader
    return True


def read_lines(path: Path) -> list[Record]:
    """The records of one file, see :func:`damaged_last_line`."""
    if not path.exists():
        return []
    kept, damaged = damaged_last_line(path)
    if damaged:
        warn_of(path, damaged, "is passed over")
    try:
        text = path.read_bytes()[:kept].decode()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"cannot read {path}: {error}") from error
    lines = enumerate(text.split("\n"), 1)
    return [read_record(line, f"{path}, line {i}") for i, line in lines if line.strip()]


def warn_of(path: Path, damaged: bytes, what: str) -> None:
    """Say that a line is passed over, or where it went."""
    shown = damaged[:40].decode(errors="replace").strip()
    message = f"{path}: the last line was not written to its end and {what}: {shown!r}"
    warnings.warn(message, DamagedRecordsWarning, stacklevel=3)
