"""Results, and the reproduction of the paper, as self-contained HTML pages: no network, no server.

They are legible on a phone and in print. Charts are inline SVG by matplotlib; meshes are a canvas with some
sixty lines of script: plotly's script alone would add 4.7 MB to every page, and would be the only thing on it
that cannot be read without JavaScript.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Sequence
from dataclasses import astuple
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from rmesh_nlp import __version__
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import PAPER
from rmesh_nlp.io.folder import Manifest, read_text, write_text
from rmesh_nlp.io.records import Records, objective_of, parse_json, to_json
from rmesh_nlp.io.results import ROWS, Result
from rmesh_nlp.io.vtu import SolutionFields, read_vtu
from rmesh_nlp.report.blocks import (
    blocks_of,
    order_of,
    relocates,
    variant,
    variants_of,
)
from rmesh_nlp.report.columns import CONTACT, PRINTED, Column, of, of_boundaries, table_of
from rmesh_nlp.report.curves import profile_figure
from rmesh_nlp.report.figures import progress_figures, stress_figures
from rmesh_nlp.report.joined import ESTIMATES, estimate_rows
from rmesh_nlp.report.notes import MAIN_NOTES, stopped_early, units_notes
from rmesh_nlp.report.study_summary import charts, family, is_study, study_notes, summary_table
from rmesh_nlp.report.style import Page, lay_out
from rmesh_nlp.report.table import MISSING, TEMPLATES, Table
from rmesh_nlp.report.tables import SOLVE, sections_of, table_of_solves
from rmesh_nlp.settings import Values
from rmesh_nlp.study.reproduction import Statement
from rmesh_nlp.study.worker import environment

REPORT = "report.html"
CHART = Page(1)  # legible on a phone, where charts are three inches wide
CONVERGENCE, MESHES = 12, 60  # most problems, and solves with meshes, on the page
MANY = 10  # problems from which on profiles tell something

MESSAGE = Column("message", "message")

TEMPLATES.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
TEMPLATES.filters |= {"variant": variant, "family": family, "objective": objective_of}
TEMPLATES.filters["problem"] = lambda record: (record["example"], record["n"], order_of(record))


def write_report(folder: Path, results: Sequence[Result], question: str = "", title: str = "") -> Path:
    """Write ``report.html`` of a folder, with the question and the name of a study, and return its path.

    Raises BadInputError if the fields of a solution cannot be read, or the file there is the user's.
    """
    path = folder / REPORT
    Manifest(folder).claim(REPORT)
    write_text(path, page(folder, results, question, title or folder.resolve().name))
    return path


def page(folder: Path, results: Sequence[Result], question: str, title: str) -> str:
    """The page as text."""
    records = [result.record for result in results]
    rows = [row for _, block in sections_of(records) for row in block.records]
    failed = [row for row in rows if not row["success"] and row["status"] != "refused"]
    is_own = not is_study(records) and any(record["example"] not in PAPER for record in records)
    notes = (study_notes, units_notes, stopped_early) if is_study(records) else MAIN_NOTES
    with rc_context(CHART.settings):
        many = len({*map(TEMPLATES.filters["problem"], records)}) >= MANY
        profiles = [(one.title, svg(profile_figure(one, CHART))) for one in charts(results) if many]
        drawn, not_drawn = _charts(results)
    meshes, meshes_left = _meshes(results)
    every = table_of_solves(records)
    return _render(
        REPORT,
        title=title,
        question=question,
        records=records,
        bad=len(failed),
        summary=summary_table(records),
        profiles=profiles,
        convergence=[chart for what, *chart in drawn if what != "stress"],
        pressures=[chart for what, *chart in drawn if what == "stress" and is_own],
        not_drawn=not_drawn,
        meshes=meshes,
        meshes_left=meshes_left,
        solves=table_of_solves(records, PRINTED),
        forces=table_of((SOLVE, *CONTACT), of_boundaries(rows, 1 if is_own else 2), texts=2),
        estimates=table_of(ESTIMATES, estimate_rows(records), texts=4),
        more=every,
        failures=table_of((SOLVE, *of("status"), MESSAGE), failed, texts=3),
        remarks=[*every.caption.split("\n\n"), *(note for said in notes for note in said(records))],
        environments=_environments(folder, records),
    )


def _render(name: str, **content: Any) -> str:
    return TEMPLATES.get_template(name).render(version=__version__, **content)


def svg(figure: Figure) -> str:
    """A figure as an element of a page, as wide as its place."""
    text = StringIO()
    lay_out(figure)
    figure.savefig(text, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    inside = text.getvalue()[text.getvalue().index("<svg") :]
    # groups have the same names in every figure; clip paths and markers are named by their content
    inside = re.sub(r'<g id="[^"]*"', "<g", inside)
    return re.sub(r'<svg [^>]*(viewBox="[^"]*")[^>]*>', r'<svg class="chart" role="img" \1>', inside, count=1)


def _charts(results: Sequence[Result]) -> tuple[list[tuple[str, str, str]], str]:
    """What is charted of the first problems, with title and chart, and a note about the others."""
    names = variants_of([result.record for result in results])
    every, positions = blocks_of(results), {name: place for place, name in enumerate(names, 1)}
    drawn = [
        (what, block.title if objective == "energy" else f"{block.title}, {objective}", svg(figure))
        for block, own in every[:CONVERGENCE]
        for objective, what, figure in (
            *stress_figures([result for result in own if result.vtu.exists()], CHART),
            *progress_figures(block, own, CHART, positions),
        )
    ]
    rest = len(every) - CONVERGENCE
    return drawn, f"The first {CONVERGENCE} problems; {rest} more are not drawn." if rest > 0 else ""


def _meshes(results: Sequence[Result]) -> tuple[list[Values], str]:
    """Meshes and fields for the slider between the given and the relocated mesh, and what is left out."""
    solved = [r for r in results if r.record["energy"] is not None and r.vtu.exists()]
    solved = [r for r in solved if not r.record.get("repeat")]  # repetitions end on the same mesh
    solved = [r for r in solved if relocates(r.record)] or solved
    rest = len(solved) - MESHES
    shown = [result for _, own in blocks_of(solved[:MESHES]) for result in own]
    sections = sections_of([result.record for result in shown])
    names = [row["solve"] for _, block in sections for row in block.records]
    meshes = [
        {"name": name, **_mesh(read_vtu(result.vtu))} for name, result in zip(names, shown, strict=True)
    ]
    note = f"{rest} further solves are not here; their fields are in the folder solutions."
    return meshes, note if rest > 0 else ""


def _mesh(fields: SolutionFields) -> Values:
    given, final = fields.given, fields.final
    u = final.displacement
    values = {"u": u[0]} if u.shape[0] == 1 else {"|u|": np.hypot(*u), "u1": u[0], "u2": u[1]}
    values["contact stress"] = final.pressure
    if np.any(final.friction_bound > 0):
        values["tangential stress"] = final.tangential_stress
    values["motion"] = np.hypot(*(final.nodes - given.nodes))
    places = zip(("x", "y", "x0", "y0"), (*final.nodes, *given.nodes), strict=True)
    size = float(np.abs(final.nodes).max())
    return {
        **{name: _rounded(place, size) for name, place in places},
        "t": fields.triangles.T.tolist(),
        "fields": {name: _rounded(v, float(np.abs(v).max())) for name, v in values.items()},
    }


def _rounded(values: Array, unit: float) -> list[float]:
    """Five digits, which a screen does not resolve."""
    return [float(f"{value:.5g}") if abs(value) > 1e-12 * (unit or 1.0) else 0.0 for value in values]


def _environments(folder: Path, records: Records) -> list[Any]:
    """Where the solves ran, each place once; without notes of it the versions in the records."""
    notes = sorted((folder / ROWS).glob("environment-*.json"))
    places = [parse_json(read_text(path), str(path)) for path in notes]
    places = places or [{"versions": record["versions"]} for record in records if record["versions"]]
    return list({to_json(place): place for place in places}.values())


REPRODUCTION = ("reproduction.md", "reproduction.html")
HEAD = ("example", "statement", "printed", "here", "outcome", "evidence")


def write_reproduction(folder: Path, statements: Sequence[Statement], quick: bool) -> list[Path]:
    """Write ``reproduction.md`` and ``reproduction.html``; returns their paths."""
    Manifest(folder).claim(*REPRODUCTION)
    rows = [[value or MISSING for value in astuple(statement)] for statement in statements]
    table, place = Table(HEAD, rows, texts=len(HEAD)), environment()
    paths = [folder / name for name in REPRODUCTION]
    for path in paths:
        text = _render(path.name, statements=table, quick=quick, machine=platform.machine(), place=place)
        write_text(path, text)
    return paths
