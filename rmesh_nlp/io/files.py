"""Files that are never half there: written aside and renamed, or appended whole; one writer at a time."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from rmesh_nlp.errors import BadInputError

LONGEST_NAME = 150  # bytes of a file name without its suffix and those of figures; file systems allow 255
TEMPORARY = ".rmesh-writing-"  # head of the folders in which files are written before they are put in place
LOCK = ".rmesh-lock"  # file that a process locks while it writes in the folder


def safe_name(text: str) -> str:
    """A text as the name of one file in its folder, whatever the text.

    Separators and all else that shells or file systems might read otherwise become ``_``. A long
    name is cut and ends in a digest of the whole, so that different names stay different.
    """
    # only this package's own files begin with a dot; "nul" and its kin are devices on Windows
    name = re.sub(r"[^\w.+-]+", "_", text.encode(errors="replace").decode())
    name = re.sub(r"^[.-]+", "_", name) or "_"
    if len(name.encode()) <= LONGEST_NAME:
        return name
    digest = hashlib.sha256(text.encode(errors="replace")).hexdigest()[:12]
    return name.encode()[: LONGEST_NAME - 13].decode(errors="ignore") + "-" + digest


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold the right to write in an existing folder, or raise a BadInputError if somebody else holds it.

    The operating system gives it back if the process dies.
    """
    path = folder / LOCK
    lock = FileLock(path, blocking=False)
    try:
        lock.acquire()
    except Timeout as error:
        holder = path.read_text(errors="replace").strip() if path.exists() else ""
        raise BadInputError(
            f"{str(folder)!r} is being written by another rmesh"
            f"{f' (process {holder})' if holder else ''}: wait for it or choose another --out"
        ) from error
    try:
        with suppress(OSError):  # a full disk, or Windows: the lock holds without the number
            path.write_text(f"{os.getpid()}\n")
        yield
    finally:
        with suppress(OSError):
            path.unlink()  # still locked: nobody else holds this file
        lock.release()


@contextmanager
def folder_aside(folder: Path) -> Iterator[Path]:
    """A new folder in a folder, for this user alone, removed at the end; it is locked while in use."""
    folder.mkdir(parents=True, exist_ok=True)
    place = Path(tempfile.mkdtemp(prefix=TEMPORARY, dir=folder))
    try:
        with FileLock(place / LOCK):
            yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def remove_leftovers(folder: Path) -> None:
    """Remove what killed writers left aside in a folder and in those inside; a living writer's files stay."""
    inside = [path for path in folder.glob(f"*/{TEMPORARY}*") if not path.parent.is_symlink()]
    for path in (*folder.glob(f"{TEMPORARY}*"), *inside):
        if path.is_dir() and not path.is_symlink():
            with suppress(OSError), FileLock(path / LOCK, blocking=False):
                shutil.rmtree(path, ignore_errors=True)


def write_whole(
    path: Path, write: Callable[[Path], object], put: Callable[[Path, Path], object] = os.replace
) -> None:
    """Let ``write`` fill a file aside, force it to the disk, then put it in place at once.

    The file is filled in a new folder that only this user can enter, with a name that cannot be
    foreseen: nobody can put a link in its way. A link at ``path`` itself is replaced, not followed.
    """
    with folder_aside(path.parent) as folder:
        aside = folder / path.name
        write(aside)
        with aside.open("rb") as file:
            os.fsync(file.fileno())  # a renamed file that is not yet on the disk is empty after a power cut
        put(aside, path)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    write_whole(path, lambda aside: aside.write_text(text, encoding="utf-8"))


def write_new(path: Path, text: str) -> None:
    """Write a text file whole; a FileExistsError is raised if something has this name, which stays."""
    write_whole(path, lambda aside: aside.write_text(text, encoding="utf-8"), _put_new)


def _put_new(aside: Path, path: Path) -> None:
    try:
        os.link(aside, path)  # unlike a rename it never replaces
    except FileExistsError:
        raise
    except OSError as error:  # a file system without links
        if os.path.lexists(path):
            raise FileExistsError(f"{path} exists") from error
        os.replace(aside, path)


def append_whole(path: Path, text: str) -> None:
    """Append a text and force it to the disk; if that raises an OSError the file is as it was before.

    A full disk takes a part of what it is given without an error. The rest is offered
    again, and the error that then comes removes the part. Only one process may append at a time.
    """
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
    descriptor = os.open(path, flags, 0o644)
    try:
        before, rest = os.fstat(descriptor).st_size, text.encode()
        try:
            while rest:
                rest = rest[os.write(descriptor, rest) :]
            os.fsync(descriptor)
        except BaseException:
            with suppress(OSError):
                os.ftruncate(descriptor, before)
            raise
    finally:
        os.close(descriptor)


def read_text(path: Path) -> str:
    """The text of a file; a BadInputError if it cannot be read or is not UTF-8."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"cannot read {path}: {error}") from error
