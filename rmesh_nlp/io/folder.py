"""An output folder: files that are never half there, one writer at a time, only own files replaced."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from itertools import count
from pathlib import Path, PurePosixPath

from filelock import FileLock, Timeout

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.optimize.budget import deferred

LONGEST_NAME = 150  # bytes of a file name without its suffix and those of figures; file systems allow 255
TEMPORARY = ".rmesh-writing-"  # head of the folders in which files are written before they are put in place
LOCK = ".rmesh-lock"  # file that a process locks while it writes in the folder
MANIFEST = ".rmesh-files"  # the list of this package's own files in a folder
PREVIOUS = "previous"  # sub-folder to which they are moved

HEAD = "# Files that rmesh wrote here, one a line; it replaces and moves no others.\n"


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


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a file aside, force it to the disk, then put it in place at once.

    The file is filled in a new folder that only this user can enter, with a name that cannot be
    foreseen: nobody can put a link in its way. A link at ``path`` itself is replaced, not followed.
    A first Ctrl-C takes effect when nothing is left aside.
    """
    with deferred() as interrupted, folder_aside(path.parent) as folder, _naming(path):
        aside = folder / path.name
        write(aside)
        with aside.open("rb") as file:
            os.fsync(file.fileno())  # a renamed file that is not yet on the disk is empty after a power cut
        os.replace(aside, path)
    if interrupted():
        raise KeyboardInterrupt


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """An OSError that names no file, or one aside, is one of ``path``."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror or str(error), str(path)) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    write_whole(path, lambda aside: aside.write_text(text, encoding="utf-8"))


def append_whole(path: Path, text: str) -> None:
    """Append a text and force it to the disk; if that raises an OSError the file is as it was before.

    A full disk takes a part of what it is given without an error. The rest is offered
    again, and the error that then comes removes the part. Only one process may append at a time.
    """
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
    is_new = not os.path.lexists(path)
    with _naming(path):
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
                    if is_new:
                        path.unlink()
                raise
        finally:
            os.close(descriptor)


def read_text(path: Path) -> str:
    """The text of a file; a BadInputError if it cannot be read or is not UTF-8."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"cannot read {path}: {error}") from error


class Manifest:
    """The list of this package's own files in a folder, itself a file there.

    A name is noted before its file is written: a list that names too much is harmless, and one
    that names too little would make an own file look like a user's.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.path = folder, folder / MANIFEST

    @property
    def exists(self) -> bool:
        """Whether this package wrote here."""
        return self.path.is_file() and not self.path.is_symlink()

    def names(self) -> list[str]:
        """Names noted so far, relative to the folder.

        Names that lead out of the folder, by themselves or through a link, are left out: whoever
        reads, replaces, moves or removes by these names stays inside.
        """
        lines = self.path.read_text(encoding="utf-8", errors="replace").splitlines() if self.exists else []
        is_inside = cache(self._is_inside)
        return [
            name
            for name in dict.fromkeys(lines)
            if name and name[0] != "#" and not name.endswith(MANIFEST)
            if is_inside(PurePosixPath(name).parent) and not os.path.islink(self.folder / name)
        ]

    def _is_inside(self, path: PurePosixPath) -> bool:
        """Whether a folder below this one is really there: no link and no ``..`` leads elsewhere."""
        if path.is_absolute() or ".." in path.parts:
            return False
        try:
            return Path(os.path.realpath(self.folder / path)) == Path(os.path.realpath(self.folder)) / path
        except ValueError:  # a null character
            return False

    def check(self, names: Iterable[str]) -> None:
        """Raise a BadInputError if a name, or a folder of its path, is taken by something else."""
        own = set(self.names())
        for name in names:
            for parent in _folders(name):
                above = self.folder / parent
                if above.is_symlink():
                    raise BadInputError(f"{above} is a link: results are written in their own folder only")
                if above.exists() and not above.is_dir():
                    raise BadInputError(f"{above} is a file, where a folder is to be written")
            path = self.folder / name
            if os.path.lexists(path) and (name not in own or path.is_dir()):
                raise BadInputError(
                    f"{path} exists and rmesh did not write it: move it, or choose another folder"
                )

    def claim(self, *names: str) -> None:
        """Check names and note them as this package's own; their files are then written."""
        self.check(names)
        own = set(self.names())
        if fresh := [name for name in names if name not in own]:
            append_whole(self.path, ("" if self.exists else HEAD) + "".join(f"{name}\n" for name in fresh))

    def set_aside(self) -> Path | None:
        """Move all own files to the first free of ``previous``, ``previous-2``, ...; nothing is deleted.

        Returns where they are, None if there were none.
        """
        present = [name for name in self.names() if os.path.lexists(self.folder / name)]
        if not present:
            return None
        target = self._new_previous()
        for name in present:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(self.folder / name, target / name)
        os.replace(self.path, target / MANIFEST)
        self._remove_empty(present)
        return target

    def remove(self, names: Iterable[str]) -> None:
        """Remove those of the own files that are named, and folders that this leaves empty."""
        own = set(self.names())
        present = [name for name in names if name in own]
        for name in present:
            with suppress(IsADirectoryError):
                (self.folder / name).unlink(missing_ok=True)
        self._remove_empty(present)

    def _remove_empty(self, names: Iterable[str]) -> None:
        above = {parent for name in names for parent in _folders(name)}
        for parent in sorted(above, key=lambda path: -len(path.parts)):
            with suppress(OSError):  # not empty: something of the user's is there
                (self.folder / parent).rmdir()

    def _new_previous(self) -> Path:
        for number in count(1):
            target = self.folder / (PREVIOUS if number == 1 else f"{PREVIOUS}-{number}")
            with suppress(FileExistsError):  # an older run, or a file or link of the user's
                target.mkdir()
                break
        return target


def _folders(name: str) -> list[PurePosixPath]:
    """The folders on the way to a file, the innermost first."""
    return list(PurePosixPath(name).parents)[:-1]
