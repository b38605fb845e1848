"""Errors that are the caller's to mend."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

Place = tuple[str | int, ...]
"""Names of nested tables of a file and numbers in lists, from 0, down to a value."""


class BadInputError(ValueError):
    """Something given by the user cannot be used; the message is one line and names it."""


class InterruptedSolveError(Exception):
    """The user interrupted a solve; the message says what is kept."""


def expect(name: str, value: object, kind: type, hint: str = "") -> None:
    """Refuse what is of another kind."""
    if not isinstance(value, kind):
        raise BadInputError(f"{name} must be {kind.__name__}{hint}, got {one_line(repr(value))[:60]}")


def expect_list(name: str, value: object, of: str) -> None:
    """Refuse what is no list; a text is none."""
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise BadInputError(f"{name} must be a list of {of}, got {one_line(repr(value))[:60]}")


def unknown(what: str, name: str, known: Iterable[str], otherwise: str = "choose from none") -> BadInputError:
    """The error for a name that is not known, with the nearest one that is, or ``otherwise`` if none is."""
    names = list(known)
    if not names:
        return BadInputError(f"unknown {what} {name!r}: {otherwise}")
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    return BadInputError(f"unknown {what} {name!r}: {hint}choose from {', '.join(names)}")


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
        raise BadInputError(f"{place}: {one_line(error)}") from error


class ProblemError(BadInputError):
    """A problem that contradicts itself.

    ``place`` says where its cause stands in a problem file, as far as that is known: the name of a table
    alone, or with what is inside of it, such as ``("contact", 0, "friction")`` for the first obstacle.
    ``part`` is the table.
    """

    def __init__(self, place: str | Place, message: str) -> None:
        super().__init__(message)
        self.place = (place,) if isinstance(place, str) else place
        self.part = self.place[0]


@contextmanager
def contradicting(place: Place) -> Iterator[None]:
    """A ValueError in this context is a ProblemError at a place."""
    try:
        yield
    except ValueError as error:
        raise ProblemError(place, str(error)) from error
