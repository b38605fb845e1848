"""One writer at a time in a folder of results."""

from __future__ import annotations

import os
from pathlib import Path
from types import TracebackType

from rmesh_nlp.errors import BadInputError

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
