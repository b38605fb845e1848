"""Errors that are the caller's to mend."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

Place = tuple[str | int, ...]
"""Names of nested tables of a file and numbers in lists, from 0, down to a value."""


class BadInputError(ValueError):
    """Something given by the user cannot be used; the message is one line and names it.

    ``place`` says where it stands, as far as that is known: the name of an argument in Python, or in a
    problem file names of tables and numbers of lists, such as ``("contact", 0, "friction")``.
    """

    def __init__(self, message: str, place: str | Place = ()) -> None:
        super().__init__(message)
        self.place: Place = (place,) if isinstance(place, str) else place


class InterruptedSolveError(Exception):
    """The user interrupted a solve; the message says what is kept."""


def require(holds: object, name: str, must: str, value: object) -> None:
    """Refuse the value of an argument, which ``must`` do something, unless that holds."""
    if not holds:
        raise BadInputError(f"{name} must {must}, got {one_line(repr(value))[:60]}", name)


def expect(name: str, value: object, kind: type, hint: str = "") -> None:
    """Refuse what is of another kind."""
    require(isinstance(value, kind), name, f"be {kind.__name__}{hint}", value)


def expect_list(name: str, value: object, of: str) -> None:
    """Refuse what is no list; a text is none."""
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    require(is_list, name, f"be a list of {of}", value)


def expect_path(path: object) -> None:
    """Refuse what names no file."""
    require(isinstance(path, (str, os.PathLike)), "path", "be the name of a file", path)


def unknown(what: str, name: object, known: Iterable[str]) -> BadInputError:
    """The error for a name that is not known, with the nearest one that is."""
    names = list(known)
    near = difflib.get_close_matches(str(name), names, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    return BadInputError(f"unknown {what} {name!r}: {hint}choose from {', '.join(names) or 'none'}", what)


def nearest(name: str, known: Iterable[str]) -> str:
    """The end of a message about a name that is not known: the nearest one that is, or all of them."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1)
    return f", did you mean {near[0]!r}?" if near else f": choose from {', '.join(names)}"


def one_line(error: object) -> str:
    """The message of an error without line breaks."""
    return " ".join(str(error).split())


@contextmanager
def located(place: object, kinds: tuple[type[Exception], ...] = (ValueError,)) -> Iterator[None]:
    """What is wrong in this context is bad input at a place: a file, or an entry of one."""
    try:
        yield
    except kinds as error:
        raise BadInputError(f"{place}: {one_line(error)}", getattr(error, "place", ())) from error


class ProblemError(BadInputError):
    """A problem that contradicts itself."""

    def __init__(self, place: str | Place, message: str) -> None:
        super().__init__(message, place)


@contextmanager
def contradicting(place: Place) -> Iterator[None]:
    """A ValueError in this context is a ProblemError at a place."""
    try:
        yield
    except ValueError as error:
        raise ProblemError(place, str(error)) from error
