"""Which files in a folder are this package's own: only those are ever replaced or moved."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from itertools import count
from pathlib import Path, PurePosixPath

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.files import append_whole

MANIFEST = ".rmesh-files"
PREVIOUS = "previous"

HEAD = "# Files that rmesh wrote here, one a line; it replaces and moves no others.\n"


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
        if not self.exists:
            return []
        lines = self.path.read_text(encoding="utf-8", errors="replace").splitlines()
        names = {name: PurePosixPath(name) for name in lines if name and name[0] != "#"}
        inside = {parent for parent in {path.parent for path in names.values()} if self._is_inside(parent)}
        return [
            name
            for name, path in names.items()
            if path.parent in inside and path.name != MANIFEST and not os.path.islink(self.folder / name)
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
