"""Progress of a study over all its workers, on stderr."""

from __future__ import annotations

import sys

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from rmesh_nlp.io.records import Record

EVERY = 100
"""Where there is no terminal, one line per so many solves, and one per solve that did not succeed."""


class StudyProgress:
    """A bar in a terminal; elsewhere some lines.

    Parameters
    ----------
    total, done : int
        Planned solves, and those of them that have a row.
    quiet : bool
        Say nothing.
    """

    def __init__(self, total: int, done: int, *, quiet: bool = False) -> None:
        self._console = Console(file=sys.stderr, highlight=False, soft_wrap=True, quiet=quiet)
        self._bar = Progress(
            BarColumn(20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.description}", markup=False),
            console=self._console,
            transient=True,
            disable=quiet or not self._console.is_terminal,
        )
        self._task = self._bar.add_task("", total=total, completed=done)
        self._total, self._done = total, done
        if done:
            self._console.print(f"{done} of {total} solves have a row already", markup=False)

    def __enter__(self) -> StudyProgress:
        """Start the live line."""
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the live line."""
        self._bar.stop()

    def finish(self, row: Record) -> None:
        """A row was written."""
        self._done += 1
        name = f"{row.get('example')} {row.get('variant')}"
        self._bar.update(self._task, advance=1, description=name)
        if not row.get("found") and not row.get("success") and row.get("status") != "refused":
            self._console.print(f"{name}: {row.get('status')}: {row.get('message')}", markup=False)
        if not self._console.is_terminal and (self._done % EVERY == 0 or self._done == self._total):
            self._console.print(f"{self._done} of {self._total} solves", markup=False)
