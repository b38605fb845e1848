"""Files that are never half there, and the right to write in a folder, one process at a time."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType

from rmesh_nlp.errors import BadInputError

try:
    import fcntl
except ImportError:  # Windows: no such locks there
    fcntl = None  # type: ignore[assignment]

LONGEST_NAME = 150
"""Bytes of a file name, its suffix and those of figures aside; file systems allow 255."""

TEMPORARY = ".rmesh-writing-"
"""Head of the folders in which files are written before they are put in place."""


def safe_name(text: str) -> str:
    """The text as the name of one file in the folder where it is put, whatever the text.

    Separators and all else that shells or file systems might read otherwise become ``_``; a long
    name is cut and ends in a digest of the whole, so that different names stay different.
    """
    # only this package's own files begin with a dot; "nul" and its kin are devices on Windows
    name = re.sub(r"[^\w.+-]+", "_", text.encode(errors="replace").decode())
    name = re.sub(r"^[.-]+", "_", name) or "_"
    if len(name.encode()) <= LONGEST_NAME:
        return name
    digest = hashlib.sha256(text.encode(errors="replace")).hexdigest()[:12]
    return name.encode()[: LONGEST_NAME - 13].decode(errors="ignore") + "-" + digest


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a file aside, force it to the disk, then put it in place at once.

    The file is filled in a new folder that only this user can enter, with a name that cannot be
    foreseen: nobody can put a link in its way. A link at ``path`` itself is replaced, not followed.
    """
    with _aside(path) as aside:
        write(aside)
        _to_disk(aside)
        os.replace(aside, path)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole."""
    write_whole(path, lambda aside: aside.write_text(text, encoding="utf-8"))


def write_new(path: Path, text: str) -> None:
    """Write a text file whole where there is none yet.

    Raises
    ------
    FileExistsError
        If something has this name; it is not touched.
    """
    with _aside(path) as aside:
        aside.write_text(text, encoding="utf-8")
        _to_disk(aside)
        try:
            os.link(aside, path)  # unlike a rename it never replaces
        except FileExistsError:
            raise
        except OSError as error:  # a file system without links
            if os.path.lexists(path):
                raise FileExistsError(f"{path} exists") from error
            os.replace(aside, path)


def append_whole(path: Path, text: str) -> None:
    """Append a text and force it to the disk; if that fails the file is as it was before.

    A disk that is full takes a part of what it is given without an error: the rest is offered
    again, and the error that then comes takes the part away. Only one process may append at a time.

    Raises
    ------
    OSError
        If not everything could be written.
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
    """The text of a file.

    Raises
    ------
    BadInputError
        If it cannot be read or is not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"cannot read {path}: {error}") from error


def remove_leftovers(folder: Path) -> None:
    """Take away what writers that were killed left aside in a folder and those in it.

    What a living writer fills is locked, and stays.
    """
    inside = [path for path in folder.iterdir() if path.is_dir() and not path.is_symlink()]
    for path in [left for place in (folder, *inside) for left in place.glob(f"{TEMPORARY}*")]:
        with suppress(OSError):
            descriptor = _locked(path)
            shutil.rmtree(path, ignore_errors=True)
            _unlock(descriptor)


@contextmanager
def folder_aside(folder: Path) -> Iterator[Path]:
    """A new folder in a folder, for this user alone, that goes at the end; a lock tells that it is in use."""
    folder.mkdir(parents=True, exist_ok=True)
    place = Path(tempfile.mkdtemp(prefix=TEMPORARY, dir=folder))
    descriptor = None
    with suppress(OSError):  # a file system without locks of folders: what is left there stays
        descriptor = _locked(place)
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)
        _unlock(descriptor)


@contextmanager
def _aside(path: Path) -> Iterator[Path]:
    """A path of the same name in a new private folder beside the file to be written."""
    with folder_aside(path.parent) as place:
        yield place / path.name


def _locked(folder: Path) -> int | None:
    """Hold the lock of a folder until its descriptor is closed; None on systems without ``fcntl``.

    Raises
    ------
    OSError
        If another process holds it, it is a link, or such locks are not to be had there.
    """
    if fcntl is None:
        return None
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _unlock(descriptor: int | None) -> None:
    if descriptor is not None:
        os.close(descriptor)


def _to_disk(path: Path) -> None:
    """A renamed file whose content is not yet on the disk is empty after a power cut."""
    with path.open("rb") as file:
        os.fsync(file.fileno())


try:
    import fcntl
except ImportError:  # Windows: no such locks there
    fcntl = None  # type: ignore[assignment]

LOCK = ".rmesh-lock"


class FolderLock:
    """The right to write in a folder, held by the operating system for as long as the process lives.

    The lock is advisory (``flock``) on a file of its own, so that ``kill -9`` or a power cut leaves
    none behind; the file itself goes when the lock is given back. On systems without ``fcntl`` nothing is
    locked.

    Parameters
    ----------
    folder : Path
        It must exist.

    Raises
    ------
    BadInputError
        On entering, if another process, or another lock of this one, writes there.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._path = folder, folder / LOCK
        self._descriptor: int | None = None

    def __enter__(self) -> FolderLock:
        if fcntl is None:
            return self
        while self._descriptor is None:
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                holder = os.read(descriptor, 20).decode(errors="replace").strip()
                os.close(descriptor)
                raise BadInputError(
                    f"{str(self._folder)!r} is being written by another rmesh"
                    f"{f' (process {holder})' if holder else ''}: wait for it or choose another --out"
                ) from error
            if self._is_in_place(descriptor):
                os.ftruncate(descriptor, 0)
                os.write(descriptor, f"{os.getpid()}\n".encode())
                self._descriptor = descriptor
            else:  # its last holder took the file away in between
                os.close(descriptor)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._descriptor is not None:
            self._path.unlink(missing_ok=True)  # still locked: nobody else holds this file
            os.close(self._descriptor)
            self._descriptor = None

    def _is_in_place(self, descriptor: int) -> bool:
        try:
            return os.path.samestat(os.fstat(descriptor), os.stat(self._path, follow_symlinks=False))
        except FileNotFoundError:
            return False
