"""Results, and the reproduction of the paper, as self-contained HTML pages: no network, no server.

They are legible on a phone and in print. Charts are inline SVG by matplotlib; meshes are a canvas with some
sixty lines of script: plotly's script alone would add 4.7 MB to every page, and would be the only thing on it
that cannot be read without JavaScript.
"""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Sequence, Set
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.figure import Figure

from rmesh_nlp import __version__
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples.paper import MISPRINT_61
from rmesh_nlp.io.folder import Manifest, write_text
from rmesh_nlp.io.records import Record, has_energy, objective_of
from rmesh_nlp.io.results import ROWS, Result, Results
from rmesh_nlp.io.vtu import Fields, read_vtu
from rmesh_nlp.report.blocks import (
    RELOCATING_NOTHING,
    Block,
    blocks,
    ends_of,
    gain_of,
    order_of,
    variant,
    variants_of,
    with_order,
)
from rmesh_nlp.report.columns import CERTIFICATES, COST, ENERGIES, GAIN, RESIDUALS, Column, of
from rmesh_nlp.report.curves import convergence_figure, profile_figure
from rmesh_nlp.report.designs import ENDS, FEW, LEFT, VIOLATION
from rmesh_nlp.report.figures import figure_of_designs
from rmesh_nlp.report.histories import curve
from rmesh_nlp.report.notes import block_notes, legends, stopped_early, units_notes
from rmesh_nlp.report.study_summary import charts, family, is_study, study_notes, summary_table
from rmesh_nlp.report.style import Page, lay_out
from rmesh_nlp.report.table import MISSING, Table
from rmesh_nlp.solving.parts import DESIGN
from rmesh_nlp.study.environment import environment
from rmesh_nlp.study.reproduction import Statement

REPORT = "report.html"
CHART = Page(1)  # legible on a phone, where charts are three inches wide
CONVERGENCE, MESHES, STARTS = 12, 60, 8  # most problems, solves with meshes, and names of starts on the page

# what tells solves apart, and columns of two tables of them; those that no row has are left out
WHICH = (
    Column("formulation", variant),
    Column("problem", lambda record: with_order(str(record["example"]), record)),
    Column("size", lambda record: str(record["n"])),
    *of("seed"),
)
SOLVED = (
    *of("status", "energy_initial_audited", "energy_audited"),
    *ENDS,
    replace(GAIN, of=lambda record: gain_of(*ends_of(record))),
    LEFT,
    VIOLATION,
    *of("iterations", "contact_solves", "wall_time_s"),
)
MORE = (*of("unknowns"), COST, *ENERGIES[1:], *RESIDUALS[1:], *CERTIFICATES[1:])
OF_ENERGY = ("energy_initial", "energy", "energy_initial_audited", "energy_audited")

COST_NOTE = (
    "Cost: time of build and solve over that of one contact solve on the given mesh. Residuals are "
    "dimensionless: equilibrium and complementarity of an independent contact solve on the relocated mesh, "
    "and the first-order residual of the outer problem over that on the given mesh."
)

TEMPLATES = Environment(
    loader=PackageLoader("rmesh_nlp.report", ""),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
TEMPLATES.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}


def write_report(folder: Path, results: Sequence[Result], question: str = "", title: str = "") -> Path:
    """Write ``report.html`` of a folder, with the question and the name of a study, and return its path.

    Raises BadInputError if the fields of a solution cannot be read, or the file there is the user's.
    """
    path = folder / REPORT
    Results(folder).manifest.claim(REPORT)
    write_text(path, page(folder, results, question, title or folder.resolve().name))
    return path


def page(folder: Path, results: Sequence[Result], question: str, title: str) -> str:
    """The page as text."""
    records = [result.record for result in results]
    failed = {i for i, r in enumerate(records) if not r["success"] and r["status"] != "refused"}
    shared = sum(bool(record.get("shared")) for record in records)
    remarks = study_notes(records) if is_study(records) else block_notes(records)
    head = ("formulation", "problem", "size", "status", "message")
    failures = [
        [variant(records[i]), *(str(records[i].get(name) or "") for name in ("example", "n", *head[3:]))]
        for i in sorted(failed)
    ]
    with rc_context(CHART.settings):
        profiles = [(one.title, svg(profile_figure(one, CHART))) for one in charts(results)]
        convergence, not_drawn = _convergence(results)
    meshes, meshes_left = _meshes(results)
    comparable = [_without_energies(record) for record in records]
    sections = (
        ("set-up", "Set-up", True),
        ("summary", "Formulations", True),
        ("profiles", "Profiles", profiles),
        ("convergence", "Convergence", convergence),
        ("meshes", "Meshes before and after", meshes),
        ("solves", "All solves", True),
        ("failures", "Failures", failed),
        ("notes", "Notes", True),
        ("environment", "Environment", True),
    )
    return _render(
        "report.html",
        title=title,
        question=question,
        sections=sections,
        setup=_setup(records, len(failed)),
        summary=summary_table(records),
        profiles=profiles,
        convergence=convergence,
        not_drawn=not_drawn,
        meshes=meshes,
        meshes_left=meshes_left,
        solves=_solves(comparable, SOLVED, failed),
        more=_solves(comparable, MORE, failed),
        failures=Table(head, [("", failures)], texts=5),
        remarks=[*legends(records), COST_NOTE, *units_notes(records), *stopped_early(records), *remarks],
        environments=_environments(folder, records),
        shared=f"{shared} of {len(records)} solves shared their core with something." if shared else "",
    )


def _render(name: str, **content: Any) -> str:
    loader = TEMPLATES.loader
    assert loader is not None
    style, script = (Markup(loader.get_source(TEMPLATES, file)[0]) for file in ("page.css", "page.js"))
    text = TEMPLATES.get_template(name).render(style=style, script=script, version=__version__, **content)
    return f"{text}\n"


def _setup(records: Sequence[Record], failed: int) -> dict[str, str]:
    refused = sum(record["status"] == "refused" for record in records)
    good = len(records) - refused - failed
    starts = list(dict.fromkeys("given mesh" if r["seed"] is None else f"seed {r['seed']}" for r in records))
    named = ", ".join(starts) if len(starts) <= STARTS else f"{len(starts)}, {starts[0]} to {starts[-1]}"
    families, variants, objectives = (
        ", ".join(dict.fromkeys(map(name, records))) for name in (family, variant, objective_of)
    )
    return {
        "problems": f"{len({(r['example'], r['n'], order_of(r)) for r in records})} of {families}",
        "formulations": variants,
        "outer objectives": objectives,
        "solves": f"{len(records)}, of which {good} succeeded, {refused} were refused",
        "starts": named,
    }


def svg(figure: Figure) -> str:
    """A figure as an element of a page, as wide as its place."""
    text = StringIO()
    lay_out(figure)
    figure.savefig(text, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    inside = text.getvalue()[text.getvalue().index("<svg") :]
    # groups have the same names in every figure; clip paths and markers are named by their content
    inside = re.sub(r'<g id="[^"]*"', "<g", inside)
    return re.sub(r'<svg [^>]*(viewBox="[^"]*")[^>]*>', r'<svg class="chart" role="img" \1>', inside, count=1)


def _convergence(results: Sequence[Result]) -> tuple[list[tuple[str, str]], str]:
    """Titles and charts of the first problems, and a note about the others."""
    by_record = {id(result.record): result for result in results}
    records = [result.record for result in results]
    positions = {name: position for position, name in enumerate(variants_of(records), 1)}
    charts_of, every = [], blocks(records)
    for block in every[:CONVERGENCE]:
        for objective, own in block.objectives.items():
            drawn = [curve(by_record[id(record)], block.unit, variant(record)) for record in own]
            curves, best = [one for one in drawn if one is not None], Block(tuple(own)).best
            if best is not None and any(one.feasible[-1] for one in curves):
                caption = block.title if objective == "energy" else f"{block.title}, {objective}"
                charts_of.append((caption, svg(convergence_figure(curves, best, CHART, positions))))
            designs = figure_of_designs([by_record[id(record)] for record in own], CHART)
            if designs is not None:
                charts_of.append((f"{block.title}: designs", svg(designs)))
    rest = len(every) - CONVERGENCE
    return charts_of, f"The first {CONVERGENCE} problems; {rest} more are not drawn." if rest > 0 else ""


def _without_energies(record: Record) -> Record:
    """Energies only where they compare, objectives only where they are no energies."""
    unknown = () if has_energy(record) else OF_ENERGY
    if objective_of(record) == "energy":
        unknown = (*unknown, "objective_initial", "objective_value")
    shown = {**record, **dict.fromkeys(unknown)}
    return shown | {f"{DESIGN}{name}": value for name, value in (record.get("design") or {}).items()}


def _design_columns(records: Sequence[Record]) -> tuple[Column, ...]:
    """A column for each of a few design variables."""
    names = dict.fromkeys(name for record in records for name in record.get("design") or {})
    return tuple(Column(name, DESIGN + name, ".5g") for name in names) if len(names) <= FEW else ()


def _solves(records: Sequence[Record], columns: Sequence[Column], failed: Set[int]) -> Table:
    shown = (*WHICH, *columns, *(_design_columns(records) if columns is SOLVED else ()))
    cells = {column.heading: [column.cell(record) for record in records] for column in shown}
    filled = {head: own for head, own in cells.items() if set(own) != {MISSING}}
    rows = list(zip(*filled.values(), strict=True))
    return Table(list(filled), [("", rows)], texts=2, failed=failed)


def _meshes(results: Sequence[Result]) -> tuple[list[dict[str, Any]], str]:
    """Meshes and fields for the slider between the given and the relocated mesh, and what is left out."""
    solved = [r for r in results if r.record["energy"] is not None and r.vtu.exists()]
    solved = [r for r in solved if r.record["formulation"] != RELOCATING_NOTHING] or solved
    rest = len(solved) - MESHES
    note = f"{rest} further solves are not here; their fields are in the folder solutions."
    return [_mesh(r.record, read_vtu(r.vtu)) for r in solved[:MESHES]], note if rest > 0 else ""


def _mesh(record: Record, fields: Fields) -> dict[str, Any]:
    u = fields.displacement
    values = {"u": u[0]} if u.shape[0] == 1 else {"|u|": np.hypot(*u), "u1": u[0], "u2": u[1]}
    values["contact stress"] = fields.pressure
    if np.any(fields.friction_bound > 0):
        values["tangential stress"] = fields.tangential_stress
    values["motion"] = np.hypot(*(fields.nodes - fields.initial))
    parts = [
        with_order(str(record["example"]), record),
        f"n = {record['n']}" if record["n"] else "",
        variant(record),
    ]
    parts += [f"seed {record['seed']}" if record["seed"] is not None else ""]
    parts += [f"repetition {record['repeat'] + 1}" if record.get("repeat") else ""]
    places = zip(("x", "y", "x0", "y0"), (*fields.nodes, *fields.initial), strict=True)
    size = float(np.abs(fields.nodes).max())
    return {
        "name": ", ".join(part for part in parts if part),
        **{name: _rounded(place, size) for name, place in places},
        "t": fields.triangles.T.tolist(),
        "fields": {name: _rounded(v, float(np.abs(v).max())) for name, v in values.items()},
    }


def _rounded(values: Array, unit: float) -> list[float]:
    """Five digits, which a screen does not resolve."""
    return [float(f"{value:.5g}") if abs(value) > 1e-12 * (unit or 1.0) else 0.0 for value in values]


def _environments(folder: Path, records: Sequence[Record]) -> list[dict[str, str]]:
    """Where the solves ran, each place once; without notes of it the versions in the records."""
    found: list[dict[str, str]] = []
    for path in sorted((folder / ROWS).glob("environment-*.json")):
        try:
            entries = {str(k): _flat(v) for k, v in json.loads(path.read_text()).items()}
        except (OSError, ValueError, AttributeError) as error:
            raise BadInputError(f"cannot read {path}: {error}") from error
        if entries not in found:
            found.append(entries)
    versions = sorted({_flat(record["versions"]) for record in records if record["versions"]})
    return found or [{"versions": version} for version in versions]


def _flat(value: Any) -> str:
    return ", ".join(f"{k} {v}" for k, v in value.items()) if isinstance(value, dict) else str(value)


REPRODUCTION = ("reproduction.md", "reproduction.html")
TITLE = "The paper's figures, printed and computed"
HEAD = ("example", "statement", "printed", "here", "outcome", "evidence")
INTRODUCTION = (
    "Haslinger, Neittaanmäki and Salmenjoki, Applications of Mathematics 37 (1992) 105-122, section 6. "
    "The paper truncates its digits. Met: equal to the printed digits. Passed: a lower energy was found. "
    "Cannot be met: no descent tried here reaches it; this is evidence, not a proof."
)


def write_reproduction(folder: Path, statements: Sequence[Statement], quick: bool) -> list[Path]:
    """Write ``reproduction.md`` and ``reproduction.html``; returns their paths."""
    Manifest(folder).claim(*REPRODUCTION)
    rows = [[s.example, s.what, s.printed, s.ours, s.outcome or MISSING, s.evidence] for s in statements]
    place = environment()
    remarks = [
        f"Example 6.1: {MISPRINT_61}",
        "Ends of descents depend in their last digits, and sometimes in which minimiser is found, on the "
        "processor and its linear algebra.",
        f"Made by rmesh reproduce{' --quick' if quick else ''}, rmesh-nlp {__version__}, CasADi "
        f"{place['versions']['casadi']}, {platform.machine()}, {place['blas']}.",
        *(["The quick variant takes one random start; the full one takes 40."] if quick else []),
    ]
    items = "".join(f"- {line}\n" for line in remarks)
    table = Table(HEAD, [("", rows)], texts=len(HEAD))
    words = {"title": TITLE, "introduction": INTRODUCTION, "statements": table, "remarks": remarks}
    texts = (
        "\n".join([f"# {TITLE}\n", f"{INTRODUCTION}\n", table.markdown(), items]),
        _render("reproduction.html", **words),
    )
    paths = [folder / name for name in REPRODUCTION]
    for path, text in zip(paths, texts, strict=True):
        write_text(path, text)
    return paths
