"""What all commands that read or write results have: exit codes, the folder, warnings as notes."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.folder import Manifest, folder_lock, remove_leftovers
from rmesh_nlp.io.records import DamagedRecordsWarning
from rmesh_nlp.io.results import Result, read_results
from rmesh_nlp.report.blocks import in_common_units


@contextmanager
def writable(folder: Path, names: Sequence[str] = ()) -> Iterator[Manifest]:
    """The own files of a folder, which is made if need be and locked, before time is spent on solving.

    If what happens in this context leaves it empty, what was made is taken away again. Raises OSError if it
    cannot be written, BadInputError if another process writes there, or one of ``names`` is the user's.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        manifest = Manifest(folder)
        with folder_lock(folder):
            remove_leftovers(folder)
            manifest.check(names)
            yield manifest
    finally:
        with suppress(OSError):  # not empty: keep it
            for path in made:
                path.rmdir()


def check_target(path: Path, suffix: str) -> None:
    """Raise a BadInputError unless a file has the ending of its kind, in a folder that exists."""
    if path.suffix != suffix or not path.parent.is_dir():
        raise BadInputError(f"{path}: expected a file {suffix} in a folder that exists")


@contextmanager
def notes(kind: type[Warning], head: str, *, says: bool = True) -> Iterator[None]:
    """Print warnings of a kind in one line each, if anything is said; drop others."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", kind)
        try:
            yield
        finally:
            for warning in caught:
                if says and issubclass(warning.category, kind):
                    print(f"{head}: {warning.message}", file=sys.stderr)


def read_quietly(folder: Path) -> list[Result]:
    """The results of a folder, costs in common units; what is passed over is printed in one line each.

    What killed writers left aside goes.
    """
    with notes(DamagedRecordsWarning, "rmesh: warning"):
        results = read_results(folder)
    remove_leftovers(folder)
    records = in_common_units([result.record for result in results])
    return [replace(result, record=record) for result, record in zip(results, records, strict=True)]
