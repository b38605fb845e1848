"""The two forms of AMPL's ``.nl`` files, text and binary, as one stream of records.

A record is a letter that says what follows, numbers, or both: ``J0 2`` or ``2 -1.5``. In text it is a line.
In binary the letter is a byte, a whole number four bytes (``h``: two), a real number eight, and a name its
length and its letters (ASL's ``bscanf``). Both begin with ten lines of text. AMPL's ``solve`` writes binary,
Pyomo and JuMP write text.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

Header = list[list[str]]
_HEADER = 10  # lines
_TOO_EARLY = "the file ends too early"
_ORDERS = {0: "<", 1: "<", 2: ">"}  # by the kind of arithmetic in the header
_CODES = {"i": "i", "h": "h", "f": "d"}
_CONVERSIONS = {"i": int, "h": int, "f": float, "s": str}


class TextRecords:
    """The text form, see :data:`Records`; what stands after ``#`` is a comment."""

    def __init__(self, header: Header, body: bytes) -> None:
        self.header, self._lines = header, self._bare(body)
        self._number, self._open = _HEADER, ""

    def _bare(self, body: bytes) -> Iterator[str]:
        """Lines that say something, each counted as it is asked for."""
        for line in _text(body).splitlines():
            self._number += 1
            if bare := _words(line):
                yield bare

    @property
    def place(self) -> str:
        """The number of the last line."""
        return f"line {self._number}"

    def key(self) -> str:
        """The first letter of the next line, whose rest is read next; none at the end."""
        line = next(self._lines, "")
        self._open = line[1:]
        return line[:1]

    def read(self, kinds: str) -> list[Any]:
        """The words of a line as numbers."""
        line = self._open or next(self._lines, "")
        if not line:
            raise ValueError(_TOO_EARLY)
        self._open, words = "", line.split()
        if len(words) != len(kinds):
            raise ValueError(f"{len(kinds)} numbers are expected, got {' '.join(words)!r}")
        return [_CONVERSIONS[kind](word) for kind, word in zip(kinds, words, strict=True)]


class BinaryRecords:
    """The binary form, see :data:`Records`."""

    def __init__(self, header: Header, body: bytes) -> None:
        self.header, self._body, self._at = header, body, 0
        kind = int((*header[5], "0", "0", "0")[2])
        if kind not in _ORDERS:
            raise ValueError(f"arithmetic of kind {kind} is not supported, only IEEE (1 and 2)")
        self._order = _ORDERS[kind]

    @property
    def place(self) -> str:
        """The number of bytes that have been read after the header."""
        return f"byte {self._at} after the header"

    def key(self) -> str:
        """The next byte; none at the end."""
        return self._take(min(1, len(self._body) - self._at)).decode("latin-1")

    def read(self, kinds: str) -> list[Any]:
        """The next numbers."""
        return [self._one(kind) for kind in kinds]

    def _one(self, kind: str) -> Any:
        if kind == "s":
            return _text(self._take(self._one("i")))
        code = self._order + _CODES[kind]
        return struct.unpack(code, self._take(struct.calcsize(code)))[0]

    def _take(self, n: int) -> bytes:
        if n < 0 or self._at + n > len(self._body):
            raise ValueError(_TOO_EARLY)
        self._at += n
        return self._body[self._at - n : self._at]


Records: TypeAlias = TextRecords | BinaryRecords
"""A ``.nl`` file as it is read.

``header`` has the words of its first ten lines, ``place`` says where the last record was, ``key()`` is the
letter that opens the next one, ``read(kinds)`` are the numbers of an open record or of the next one, with a
letter for each: i and h whole, f real, s a name."""


def _text(data: bytes) -> str:
    return data.decode("utf-8", errors="replace")


def _words(line: str) -> str:
    """A line without its comment."""
    return line.split("#", 1)[0].strip()


def open_records(path: Path) -> Records:
    """Open a ``.nl`` file in either form; a ValueError names it if it is none."""
    data = path.read_bytes()
    first = data[:1].decode("latin-1")
    if first not in ("g", "G", "b", "B"):
        raise ValueError(
            f"{path}: an .nl file must begin with 'g' (text) or 'b' (binary), not with {first!r}"
        )
    *lines, body = data.split(b"\n", _HEADER)
    if len(lines) < _HEADER:
        raise ValueError(f"{path}: {_TOO_EARLY}")
    header = [_words(_text(line)).split() for line in lines]
    if first in "gG":
        return TextRecords(header, body)
    try:
        return BinaryRecords(header, body)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
