"""Progress of many solves on stderr: a live line in a terminal, some lines elsewhere."""

from __future__ import annotations

import math
import sys

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from rmesh_nlp.evaluation import difference
from rmesh_nlp.io.records import Record, ends_of, gain_of, has_energy, objective_of
from rmesh_nlp.optimize.budget import Budget, Limits
from rmesh_nlp.optimize.status import NOT_STATIONARY_YET, Status
from rmesh_nlp.solving.parts import FEW, Step
from rmesh_nlp.study.plan import PlannedSolve

EVERY_S = 10.0  # seconds between lines about what goes on, where there is no terminal


class SolvesProgress:
    """Shows what is being solved; as a context it starts the live line and removes it at the end.

    ``done`` of the ``total`` solves have a row. With ``each`` every solve that ended has a line, else those
    that failed.
    """

    def __init__(self, total: int, done: int = 0, *, quiet: bool = False, each: bool = True) -> None:
        self._console = Console(file=sys.stderr, highlight=False, soft_wrap=True, quiet=quiet)
        columns: list[ProgressColumn] = [BarColumn(20), MofNCompleteColumn(), TimeElapsedColumn()]
        columns += [] if each else [TimeRemainingColumn()]
        self._bar = Progress(
            *columns,
            TextColumn("{task.description}", markup=False),
            console=self._console,
            transient=True,
            disable=quiet or not self._console.is_terminal,
        )
        self._task = self._bar.add_task("", total=total, completed=done)
        self._total, self._done, self._each = total, done, each
        self._solve: PlannedSolve | None = None
        self._said = Budget()
        if done:
            self._say(f"{done} of {total} solves have a row already")

    def __enter__(self) -> SolvesProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def start(self, solve: PlannedSolve) -> None:
        """A solve begins."""
        self._solve, self._said = solve, Budget()
        self._bar.update(self._task, description=f"{solve.name} {solve.formulation}")

    def step(self, step: Step) -> None:
        """An iteration of the solve has ended."""
        solve = self._solve
        if solve is None:
            return
        limits = Limits.of(solve.options.get("limits"))
        of_energy = str(solve.options.get("objective", "energy")).startswith("energy")
        text = f"{solve.name} {solve.formulation}: {pace(step, limits, of_energy=of_energy)}"
        self._bar.update(self._task, description=text)
        self._say_seldom(text)

    def finish(self, row: Record) -> None:
        """A solve has ended."""
        self._done += 1
        self._bar.advance(self._task)
        if self._each:
            self._say(summary(row))
            return
        self._bar.update(self._task, description=f"{row.get('example')} {row.get('variant')}")
        if not (row.get("found") or row["success"] or row["status"] == "refused"):
            self._say(summary(row))
        self._say_seldom(f"{self._done} of {self._total} solves", at_once=self._done == self._total)

    def _say_seldom(self, text: str, *, at_once: bool = False) -> None:
        """A line where there is no live one, unless there was one a moment ago."""
        if not self._console.is_terminal and (at_once or self._said.elapsed > EVERY_S):
            self._said = Budget()
            self._say(text)

    def _say(self, text: str) -> None:
        self._console.print(text, markup=False)


def summary(row: Record) -> str:
    """One line about a row."""
    line = f"{row['example']} {row.get('variant') or row['formulation']}: {row['status']}"
    before, after = ends_of(row)
    what, form = ("audited J", ".6f") if objective_of(row) == "energy" else ("objective", ".5g")
    if after is not None and (has_energy(row) or what == "objective"):
        line += f", {what} = " + (f"{before:{form}} -> " if before is not None else "") + f"{after:{form}}"
        if before:
            line += f" (gain {difference(before, after):.4g}, {gain_of(before, after):.3g} %)"
    design = [f"{name} = {value:.4g}" for name, value in (row.get("design") or {}).items()]
    line += "".join(f", {text}" for text in design[:FEW])
    line += f" and {len(design) - FEW} more" if len(design) > FEW else ""
    if row.get("iterations") is not None:
        line += f", {row['iterations']} iterations"
    line += f", {row['wall_time_s']:.2f} s"
    if row["success"] and row["status"] != Status.CONVERGED:
        line += f": {NOT_STATIONARY_YET}"
    elif not row["success"] and row.get("message"):
        line += f": {row['message']}"
    return line


def pace(step: Step, limits: Limits, *, of_energy: bool = True) -> str:
    """One line about a step of a solve: its gain, its residual, and what is left of the limits.

    Of another objective than the energy it has the objective.
    """
    most = limits.iterations
    parts = [f"iteration {step.iteration}" + ("" if most is None else f" of {most} at most")]
    if step.said:
        parts.append(step.said)
    elif not of_energy and math.isfinite(step.objective):
        parts.append(f"objective {step.objective_given:.6g} -> {step.objective:.6g}")
    elif of_energy and math.isfinite(step.energy):
        parts += [f"J = {step.energy:.6g}", f"gain {difference(step.energy_given, step.energy):.3g}"]
    residuals = [r for r in (step.primal_residual, step.dual_residual) if math.isfinite(r)]
    if residuals and not step.said:  # the larger one, as the solver scales them
        parts.append(f"residual {max(residuals):.1e}")
    if math.isfinite(limits.seconds):
        parts.append(f"{in_words(step.seconds)} of {in_words(limits.seconds)} at most")
    return ", ".join(parts)


def in_words(seconds: float) -> str:
    """A duration."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
