"""Files that meshio reads, whatever is in them: one format, a largest size, a longest time."""

from __future__ import annotations

import contextlib
import io
import re
import signal
import threading
import warnings
import xml.etree.ElementTree
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import meshio

LARGEST_FILE = 500_000_000
"""Bytes that a mesh file may have: some five million nodes as text."""

SECONDS, SECONDS_PER_BYTE = 10.0, 2e-6
"""Longest time of the processor to read a file: meshio takes about 2e-7 seconds per byte of text."""


class _TooLongError(Exception):
    pass


def read_file(path: Path) -> Any:
    """The ``meshio.Mesh`` of a file, read in the format of its extension and no other.

    Some of meshio's readers never come to the end of a damaged file, so their time is limited.

    Raises
    ------
    ValueError
        If it cannot be read, is too large, or takes too long.
    """
    kind = _format(path)
    try:
        size = path.stat().st_size
    except OSError as error:
        raise ValueError(f"{path}: cannot be read as a mesh: {error.strerror}") from error
    if not path.is_file():
        raise ValueError(f"{path}: cannot be read as a mesh: it is not a file")
    if size == 0:
        raise ValueError(f"{path}: cannot be read as a mesh: it is empty{AGAIN}")
    if size > LARGEST_FILE:
        raise ValueError(f"{path}: has {size} bytes: of a mesh no more than {LARGEST_FILE} are read")
    seconds = SECONDS + SECONDS_PER_BYTE * size
    said = io.StringIO()  # meshio prints what it dislikes
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(io.StringIO()), _no_warnings():
            return _limited(lambda: meshio.read(path, kind), seconds)
    except _TooLongError:
        raise ValueError(
            f"{path}: cannot be read as a mesh: the reader of {kind} found no end within {seconds:.0f} s; "
            "the file may be damaged"
        ) from None
    except (SystemExit, Exception) as error:  # meshio's readers raise anything, some call sys.exit
        reason = _reason(error, said.getvalue())
        raise ValueError(f"{path}: cannot be read as a mesh of the format {kind}: {reason}") from error


AGAIN = "; export it again, as .msh of gmsh or .vtu if it can be"

NO_NUMBER = re.compile(r"(?:could not convert string to float|invalid literal for int\(\).*?): (.*)")

INTERNAL = (AssertionError, AttributeError, IndexError, TypeError, NameError)
"""Errors of a reader that met what it was not made for; their texts speak of its code."""


def _reason(error: BaseException, said: str) -> str:
    """One line for people on why a reader of meshio gave up, and what to do."""
    if isinstance(error, ModuleNotFoundError):
        return f"this format needs the package {error.name}: pip install {error.name}"
    text = " ".join(str(error).split())
    number = NO_NUMBER.match(text)
    if isinstance(error, SystemExit):  # its reason was printed
        lines = [line for line in said.splitlines() if re.match(r"\s*[A-Za-z]", line)]
        text = lines[-1].strip() if lines else "its content is in another format"
    elif isinstance(error, UnicodeDecodeError):
        text = "it is not a text file"
    elif isinstance(error, xml.etree.ElementTree.ParseError):
        text = f"it is no XML at line {error.position[0]}, column {error.position[1]}"
    elif isinstance(error, KeyError):
        text = f"{error.args[0] if error.args else 'a part'} is missing in it, or the reader does not know it"
    elif number:
        text = f"{number[1].strip()} stands where a number is expected"
    elif isinstance(error, INTERNAL) or not text:
        text = "it is damaged, or has parts that the reader does not know"
    return text.rstrip(".") + AGAIN


@contextlib.contextmanager
def _no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _format(path: Path) -> str:
    """The format of the extension; ``.msh`` has two, told apart by their first line."""
    suffix = path.suffix.lower()
    kinds = meshio.extension_to_filetypes.get(suffix, [])
    if not kinds:
        known = ", ".join(sorted(meshio.extension_to_filetypes))
        raise ValueError(f"{path}: cannot be read as a mesh: the extension {suffix!r} is none of {known}")
    if len(kinds) == 1:
        return str(kinds[0])
    with contextlib.suppress(OSError), path.open("rb") as file:
        if file.read(200).lstrip().startswith(b"$"):
            return "gmsh"
    return str(kinds[0])


def _limited(read: Callable[[], Any], seconds: float) -> Any:
    """What ``read`` returns, if it does so in time."""
    if hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread():
        with _alarm(seconds):
            return read()
    return _in_a_thread(read, seconds)


@contextlib.contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    def ring(*_: Any) -> None:
        raise _TooLongError

    # time of the processor: on a busy machine a good file may take ten times as long by the clock
    before = signal.signal(signal.SIGPROF, ring)
    timer = signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, *timer)
        signal.signal(signal.SIGPROF, before)


def _in_a_thread(read: Callable[[], Any], seconds: float) -> Any:
    """The same where no signal can interrupt: a reader that hangs is left behind in its thread."""
    result: list[Any] = []

    def work() -> None:
        try:
            result.append((read(), None))
        except BaseException as error:
            result.append((None, error))

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(seconds)
    if not result:
        raise _TooLongError
    value, error = result[0]
    if error is not None:
        raise error
    return value
