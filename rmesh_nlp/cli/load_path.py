"""What ``rmesh path`` does: a foundation that moves in steps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.ticker import MaxNLocator

from rmesh_nlp.cli.folders import NO_SUCCESS, SUCCESS, located, writable
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.export import write_solution
from rmesh_nlp.io.files import safe_name, write_text, write_whole
from rmesh_nlp.io.problem_builder import build
from rmesh_nlp.io.problem_file import read_table, with_order
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.units import bracketed
from rmesh_nlp.report.style import Page, look, new_figure, save
from rmesh_nlp.solving.driver import solve
from rmesh_nlp.solving.load_path import PathStep, load_path
from rmesh_nlp.solving.options import accepted


def path(file: Path, formulation: str | None, order: int | None, out: Path | None) -> int:
    """Solve the load path of a problem file; returns the exit code."""
    table = with_order(read_table(file), order)
    plan = table.path
    if plan is None:
        raise BadInputError(f"{file}: has no table [path]: move = [dx, dy], steps = 5")
    problem = build(table, file)
    if problem.design:
        said = f"a load path has no design: write numbers in the place of {', '.join(problem.start)}"
        raise BadInputError(f"{file}: {said}, or leave out [path]")
    name = formulation or table.solve.formulation
    if plan.relocate == "each" and not accepted(name, ["start"]):
        raise BadInputError(f"{file}: the formulation {name!r} takes no start: choose relocate = 'once'")
    folder = Path("results") / f"{safe_name(problem.name)}-path" if out is None else out
    frames = [f"step-{number:03d}.vtu" for number in range(1, plan.steps + 1)]
    files = ["path.csv", "path.png", "path.pdf", "path.pvd", *frames]
    done: list[PathStep] = []
    with writable(folder, files) as results:
        results.manifest.claim(*files)
        with located(file):
            relocate, hold = partial(solve, formulation=name), partial(solve, formulation="fixed")
            about: dict[str, Any] = {"obstacle": plan.contact - 1, "relocate": plan.relocate, "hold": hold}
            for step in load_path(problem, plan.move, plan.steps, relocate, **about):
                done.append(step)
                write = partial(write_solution, step.solution, file_format="vtu")
                write_whole(folder / frames[step.number - 1], write)
                row = step.row()
                print(
                    f"step {step.number} of {plan.steps}: {row['status']}, J = {row['energy']:.6g}, contact "
                    f"force ({row['force_x']:.4g}, {row['force_y']:.4g}), {row['touching_nodes']} nodes touch"
                )
        _write(folder, problem, done, frames)
    print(f"wrote {folder}: {', '.join(files[:4])} and {len(frames)} steps")
    return SUCCESS if all(step.solution.success for step in done) else NO_SUCCESS


def _write(folder: Path, problem: ContactProblem, steps: Sequence[PathStep], frames: Sequence[str]) -> None:
    rows = [step.row() for step in steps]
    table = pd.DataFrame(rows)
    write_whole(folder / "path.csv", lambda aside: table.to_csv(aside, index=False, lineterminator="\r\n"))
    entries = [
        f'    <DataSet timestep="{step.number}" file={quoteattr(frame)}/>'
        for step, frame in zip(steps, frames, strict=True)
    ]
    head = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>"]
    write_text(folder / "path.pvd", "\n".join([*head, *entries, "  </Collection>", "</VTKFile>", ""]))
    _draw(folder, problem, rows)


def _draw(folder: Path, problem: ContactProblem, rows: Sequence[dict[str, Any]]) -> None:
    """Contact force and largest pressure over the way of the foundation."""
    way = [float(np.hypot(row["moved_x"], row["moved_y"])) for row in rows]
    force = [float(np.hypot(row["force_x"], row["force_y"])) for row in rows]
    pressure = [row["largest_pressure"] for row in rows]
    page, units = Page(2), problem.units
    per_thickness = f"{units.force}/{units.length}" if units.force and units.length else ""
    with rc_context(page.settings):
        figure = new_figure(page.width, page.line_height)
        axes = figure.subplots(1, 2)
        labels = (f"contact force{bracketed(per_thickness)}", f"largest pressure{bracketed(units.stress)}")
        for axis, values, label in zip(axes, (force, pressure), labels, strict=True):
            axis.plot(way, values, color=look(1).color, marker="o", markersize=3)
            axis.set(xlabel=f"way of the foundation{bracketed(units.length)}", ylabel=label)
            axis.set(xlim=(0, 1.05 * max(way)), ylim=(0, 1.08 * max(*values, 1e-300)))
            axis.xaxis.set_major_locator(MaxNLocator(5))
        save(figure, folder / "path", settings=page.settings)
