"""Results to figures like 6.1 to 6.10 of the paper, PNG and PDF; nothing is solved here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from rmesh_nlp.io.files import safe_name
from rmesh_nlp.io.manifest import Manifest
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import Result
from rmesh_nlp.io.vtu import read_vtu
from rmesh_nlp.problem.units import units_of
from rmesh_nlp.report.blocks import RELOCATING_NOTHING, Block, blocks, label
from rmesh_nlp.report.convergence import convergence_figure, curve
from rmesh_nlp.report.errors import bracket_figure, error_figure, is_certified
from rmesh_nlp.report.grids import grid_figure, surface_figure
from rmesh_nlp.report.profile_figures import profile_figures
from rmesh_nlp.report.stresses import stress_figure
from rmesh_nlp.report.study_summary import charts, is_study
from rmesh_nlp.report.style import SETTINGS, save

GIVEN = "given grid"


FORMATS = ("png", "pdf")


def write_figures(results: Sequence[Result], folder: Path, manifest: Manifest | None = None) -> list[Path]:
    """Draw everything that the results hold and return the files.

    Parameters
    ----------
    manifest : Manifest, optional
        Of the folder above: figures are noted there, and no file is replaced that is not.

    Raises
    ------
    BadInputError
        If the fields of a solution cannot be read, or a file of the user's is in the way.
    """
    paths: list[Path] = []
    for name, figure in _all_figures(results):
        stem = _unused(safe_name(name), paths)
        if manifest is not None:
            manifest.claim(*(f"{folder.name}/{stem}.{kind}" for kind in FORMATS))
        paths += save(figure, folder / stem, FORMATS)
    return paths


def _all_figures(results: Sequence[Result]) -> Iterator[tuple[str, Figure]]:
    """Of a study its profiles; of a comparison those of each block."""
    records = [result.record for result in results]
    if is_study(records):
        with rc_context(SETTINGS):
            yield from profile_figures(charts(results))
        return
    by_record = {id(result.record): result for result in results}
    for block in blocks(records):
        yield from block_figures(block, [by_record[id(record)] for record in block.records])
    yield from _brackets(records)


def _brackets(records: Sequence[Record]) -> Iterator[tuple[str, Figure]]:
    """A figure per example that was certified on more than one mesh."""
    certified = [record for record in records if is_certified(record) and record.get("nodes")]
    with rc_context(SETTINGS):
        for example in dict.fromkeys(record["example"] for record in certified):
            rows = [record for record in certified if record["example"] == example]
            if len({record["nodes"] for record in rows}) > 1:
                yield f"{example}-bracket", bracket_figure(rows)


def block_figures(block: Block, results: Sequence[Result]) -> Iterator[tuple[str, Figure]]:
    """Names and figures of one block: grids, stresses, convergence, and a surface if scalar.

    Formulations are compared with the solution of ``fixed``; without it, what would show the
    given grid is left out.
    """
    drawn = [
        (result.record, read_vtu(result.vtu)) for result in results if result.record["energy"] is not None
    ]
    units = units_of(block.records[0].get("units"))
    stem = f"{block.example}-{block.records[0]['n']}"
    fixed = [field for record, field in drawn if record["formulation"] == RELOCATING_NOTHING]
    given = {GIVEN: fixed[0]} if fixed else {}
    moved = [(record, field) for record, field in drawn if record["formulation"] != RELOCATING_NOTHING]
    with rc_context(SETTINGS):
        for record, field in moved:
            panels = {**given, f"relocated by {label(record)}": field}
            yield f"{record.get('key', stem)}-grid", grid_figure(panels, units)
            if field.error_bound is not None and field.error_bound_initial is not None:
                yield f"{record.get('key', stem)}-error", error_figure(field, record)
        if given and not moved:
            yield f"{stem}-grid", grid_figure(given, units)
        for objective in _objectives(block):
            named = {label(r): field for r, field in moved if r["objective"] == objective}
            if drawn and drawn[0][1].contact.any() and (named or not moved):
                yield f"{stem}{_suffix(objective)}-stress", stress_figure({**given, **named}, units)
        if drawn and drawn[0][1].displacement.shape[0] == 1:
            best = {f"relocated by {label(r)}": f for r, f in moved if r is block.best}
            every = {label(record): field for record, field in moved}
            yield f"{stem}-surface", surface_figure({**given, **best} or every)
        for objective in _objectives(block):
            same = [result for result in results if result.record["objective"] == objective]
            curves = [one for result in same if (one := curve(result, block.unit)) is not None]
            lowest = Block(tuple(result.record for result in same)).best
            if curves and lowest is not None:
                yield f"{stem}{_suffix(objective)}-convergence", convergence_figure(curves, lowest)


def _objectives(block: Block) -> list[str]:
    """What was minimised in a block, in the order of its rows."""
    return list(dict.fromkeys(record["objective"] for record in block.records))


def _suffix(objective: str) -> str:
    """What tells figures of other objectives from those of the energy."""
    return "" if objective == "energy" else f"-{objective}"


def _unused(name: str, paths: Sequence[Path]) -> str:
    """The name, numbered if an earlier figure has it."""
    taken = {path.stem for path in paths}
    candidates = [name, *(f"{name}-{number}" for number in range(2, len(paths) + 3))]
    return next(candidate for candidate in candidates if candidate not in taken)
