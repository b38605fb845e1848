"""Progress of a campaign on stderr: a live line in a terminal, one line per solve elsewhere."""

from __future__ import annotations

import sys
import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from rmesh_nlp.io.records import Record
from rmesh_nlp.optimize.status import NOT_STATIONARY_YET, Status
from rmesh_nlp.solving.clock import Limits
from rmesh_nlp.solving.parts import Step
from rmesh_nlp.study.cases import Case
from rmesh_nlp.study.pace import Pace

EVERY_S = 10.0
"""Seconds between lines about a solve that goes on, where there is no terminal."""


class CampaignProgress:
    """Shows what is being solved and, for each solve that ended, one line.

    Parameters
    ----------
    total : int
        Number of solves.
    quiet : bool
        Show nothing.
    """

    def __init__(self, total: int, *, quiet: bool = False) -> None:
        console = Console(file=sys.stderr, highlight=False, soft_wrap=True, quiet=quiet)
        self._bar = Progress(
            BarColumn(20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.description}", markup=False),
            console=console,
            transient=True,
            disable=quiet or not console.is_terminal,
        )
        self._console = console
        self._task = self._bar.add_task("", total=total)
        self._name = ""
        self._pace, self._said = Pace(), time.monotonic()

    def __enter__(self) -> CampaignProgress:
        """Start the live line."""
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Remove the live line."""
        self.stop()

    def stop(self) -> None:
        """Remove the live line and show the cursor again."""
        self._bar.stop()

    def start(self, case: Case) -> None:
        """A solve begins."""
        self._name = f"{case.problem.name} {case.formulation}"
        limit = None if case.options.keys() & {"starts", "levels"} else case.options.get("time_limit_s")
        self._pace, self._said = Pace(limit or Limits.seconds), time.monotonic()
        self._bar.update(self._task, description=self._name)

    def step(self, step: Step) -> None:
        """An iteration has ended."""
        self._pace(step)
        text = f"{self._name}: {self._pace.text()}"
        self._bar.update(self._task, description=text)
        if not self._console.is_terminal and time.monotonic() - self._said > EVERY_S:
            self._said = time.monotonic()
            self._console.print(text, markup=False)

    def finish(self, record: Record) -> None:
        """A solve has ended."""
        self._bar.advance(self._task)
        self._console.print(summary(record), markup=False)


def summary(record: Record) -> str:
    """One line about a record."""
    line = f"{record['example']} {record['formulation']}: {record['status']}"
    after, before = record.get("energy_audited"), record.get("energy_initial_audited")
    if after is not None:
        line += ", audited J = " + (f"{before:.6f} -> " if before is not None else "") + f"{after:.6f}"
        if before:
            line += f" (gain {before - after:.4g}, {100 * (before - after) / abs(before):.3g} %)"
    if record["iterations"] is not None:
        line += f", {record['iterations']} iterations"
    line += f", {record['wall_time_s']:.2f} s"
    if record["success"] and record["status"] != Status.CONVERGED:
        line += f": {NOT_STATIONARY_YET}"
    elif not record["success"] and record.get("message"):
        line += f": {record['message']}"
    return line
