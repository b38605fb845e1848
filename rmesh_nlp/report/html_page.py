"""Results to one self-contained HTML page: no network, no server, legible on a phone and in print.

Charts are inline SVG and meshes a canvas with some sixty lines of script of our own: plotly's script alone
would add 4.7 MB to every page, and would be the only thing on it that cannot be read without JavaScript.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from rmesh_nlp import __version__
from rmesh_nlp.errors import BadInputError
from rmesh_nlp.io.files import write_text
from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import ROWS, Result, Results
from rmesh_nlp.report.blocks import blocks, objective_of
from rmesh_nlp.report.columns import MISSING, contact_units, gain_in_per_cent
from rmesh_nlp.report.convergence import FLOOR, curve
from rmesh_nlp.report.notes import LEGEND, block_notes, stopped_early, units_notes
from rmesh_nlp.report.study_summary import (
    Chart,
    charts,
    family,
    is_study,
    study_notes,
    summary_rows,
    variant,
    variants_of,
)
from rmesh_nlp.report.svg import Line, line_chart
from rmesh_nlp.report.viewer import viewer

REPORT = "report.html"
CONVERGENCE = 12
"""Most problems whose convergence is on the page."""

WHICH: tuple[tuple[str, str, str], ...] = (
    ("example", "problem", "s"),
    ("n", "size", "s"),
    ("seed", "seed", "d"),
)
COLUMNS: tuple[tuple[str, str, str], ...] = (
    ("status", "status", "s"),
    ("energy_initial_audited", "J given", ".6g"),
    ("energy_audited", "J relocated", ".6g"),
    ("gain_per_cent", "gain [%]", ".2f"),
    ("iterations", "iterations", "d"),
    ("contact_solves", "contact solves", "d"),
    ("wall_time_s", "time [s]", ".3g"),
)
MORE: tuple[tuple[str, str, str], ...] = (
    ("time_contact_solves", "cost [contact solves]", ".4g"),
    ("u_min", "u min", ".4g"),
    ("u_max", "u max", ".4g"),
    ("min_area_ratio", "least area ratio", ".3f"),
    ("equilibrium_residual", "equilibrium", ".1e"),
    ("complementarity_residual", "complementarity", ".1e"),
    ("stationarity_residual", "first-order residual", ".1e"),
    ("stationarity", "label", "s"),
    ("error_bound_initial", "error bound, given", ".3g"),
    ("error_bound", "error bound, relocated", ".3g"),
)
"""Entry, heading and format: what tells solves apart, their main table, and a second one. Columns that no row
has are left out."""

RESIDUALS = (
    "Cost: time of build and solve over that of one contact solve on the given mesh. Residuals are "
    "dimensionless: equilibrium and complementarity of an independent contact solve on the relocated mesh, "
    "and the first-order residual of the outer problem over that on the given mesh."
)

STARTS = 8
"""Most starts that are named one by one."""


def write_report(folder: Path, results: Sequence[Result], question: str = "", title: str = "") -> Path:
    """Write ``report.html`` of a folder and return its path.

    Parameters
    ----------
    question, title : str
        What the study asks, and its name.

    Raises
    ------
    BadInputError
        If the fields of a solution cannot be read, or the file there is not this package's.
    """
    path = folder / REPORT
    Results(folder).manifest.claim(REPORT)
    write_text(path, page(folder, results, question, title or folder.resolve().name))
    return path


def page(folder: Path, results: Sequence[Result], question: str, title: str) -> str:
    """The page as text."""
    records = [result.record for result in results]
    drawn = charts(results)
    sections = [
        ("set-up", "Set-up", _setup(records)),
        ("summary", "Formulations", _summary(records)),
        ("profiles", "Profiles", _profiles(drawn)),
        ("convergence", "Convergence", _convergence(results)),
        ("meshes", "Meshes before and after", viewer(results)),
        ("solves", "All solves", _solves(records)),
        ("failures", "Failures", _failures(records)),
        ("notes", "Notes", _notes(records)),
        ("environment", "Environment", _environment(folder, records)),
    ]
    shown = [(name, head, body) for name, head, body in sections if body]
    links = "".join(f'<a href="#{name}">{escape(head)}</a>' for name, head, _ in shown)
    bodies = "".join(
        f'<section id="{name}"><h2>{escape(head)}</h2>{body}</section>' for name, head, body in shown
    )
    policy = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        f"<title>{escape(title)}</title><style>{resource('html_page.css')}</style></head><body>"
        f'<h1>{escape(title)}</h1><p class="question">{escape(question)}</p><nav>{links}</nav>{bodies}'
        f'<p class="note">Made by rmesh report, rmesh-nlp {escape(__version__)}.</p>'
        f"<script>{resource('html_page.js')}</script></body></html>\n"
    )


def _setup(records: Sequence[Record]) -> str:
    good = sum(record["success"] for record in records)
    refused = sum(record["status"] == "refused" for record in records)
    families = dict.fromkeys(map(family, records))
    starts = list(dict.fromkeys("given mesh" if r["seed"] is None else f"seed {r['seed']}" for r in records))
    named = ", ".join(starts) if len(starts) <= STARTS else f"{len(starts)}, {starts[0]} to {starts[-1]}"
    entries = {
        "problems": f"{len({(r['example'], r['n']) for r in records})} of {', '.join(families)}",
        "formulations": ", ".join(dict.fromkeys(map(variant, records))),
        "outer objectives": ", ".join(dict.fromkeys(objective_of(r) for r in records)),
        "solves": f"{len(records)}, of which {good} succeeded, {refused} were refused",
        "starts": named,
    }
    return _list(entries)


def _list(entries: dict[str, str]) -> str:
    return "<dl>" + "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in entries.items()) + "</dl>"


def _summary(records: Sequence[Record]) -> str:
    head, rows = summary_rows(records)
    return _table(head, rows, texts=2)


def _table(
    head: Sequence[str], rows: Sequence[Sequence[str]], texts: int, failed: Sequence[bool] = ()
) -> str:
    kind = ["text" if i < texts else "" for i in range(len(head))]
    heads = "".join(f'<th class="{k}">{escape(cell)}</th>' for k, cell in zip(kind, head, strict=True))
    lines = []
    for i, row in enumerate(rows):
        mark = ' class="failed"' if i < len(failed) and failed[i] else ""
        cells = "".join(f'<td class="{k}">{_in_lines(cell)}</td>' for k, cell in zip(kind, row, strict=True))
        lines.append(f"<tr{mark}>{cells}</tr>")
    whole = f"<thead><tr>{heads}</tr></thead><tbody>{''.join(lines)}</tbody>"
    return f'<div class="wide"><table class="sortable">{whole}</table></div>'


def _in_lines(cell: str) -> str:
    """A cell, a range after its median on a line of its own; long texts may break."""
    middle, bracket, ends = cell.partition(" [")
    if bracket and ends.endswith("]"):
        return f'{escape(middle)} <span class="range">[{escape(ends)}</span>'
    return f'<span class="long">{escape(cell)}</span>' if len(cell) > LONG else escape(cell)


LONG = 40
"""Characters of a cell that may stand in several lines."""


def _profiles(drawn: Sequence[Chart]) -> str:
    if not drawn:
        return ""
    parts = [chart_svg(one) for one in drawn]
    note = "A curve that ends below 1 shows the share of failures. Higher and further left is better."
    return f'<p class="note">{note}</p><div class="charts">{"".join(parts)}</div>'


def chart_svg(chart: Chart) -> str:
    """Profiles as an SVG; values of zero stand at the left edge of a logarithmic axis."""
    finite = [profile.at for profile in chart.profiles.values()]
    every = np.concatenate(finite) if finite else np.zeros(0)
    positive = every[every > 0]
    low = max(float(positive.min()) if positive.size else 1.0, 1e-6)
    high = max(2 * low, 1.1 * float(positive.max()) if positive.size else 2.0)
    lines, looks = [], {name: i for i, name in enumerate(chart.profiles, 1)}
    for name, profile in chart.profiles.items():
        at = np.concatenate([[low], np.maximum(profile.at, low), [high]])
        share = np.concatenate([profile(low)[None], profile.share, profile(high)[None]])
        lines.append(Line(name, at, share, looks[name], steps=True))
    whole = Line("", np.array([np.nan, np.nan]), np.array([0.0, 1.0]))
    svg = line_chart([*lines, whole], chart.title, chart.axis, "share of problems", log_x=chart.logarithmic)
    return svg


def _convergence(results: Sequence[Result]) -> str:
    by_record = {id(result.record): result for result in results}
    names = variants_of([result.record for result in results])
    looks = {name: i for i, name in enumerate(names, 1)}
    parts, every = [], blocks([result.record for result in results])
    for block in every[:CONVERGENCE]:
        for objective in dict.fromkeys(record["objective"] for record in block.records):
            own = [record for record in block.records if record["objective"] == objective]
            found = [curve(by_record[id(record)], block.unit) for record in own]
            ends = [float(one.energy[-1]) for one in found if one is not None and one.feasible[-1]]
            if not ends:
                continue
            best = min(ends)
            floor = FLOOR * abs(best) or FLOOR
            lines = []
            for record, one in zip(own, found, strict=True):
                if one is not None:
                    name = variant(record)
                    gap = np.where(one.feasible, np.maximum(np.abs(one.energy - best), floor), np.nan)
                    lines.append(Line(name, one.cost, gap, looks[name]))
            symbol, what = ("J", "") if objective == "energy" else ("F", f", {objective}")
            title = f"{block.title}{what}"
            label = f"|{symbol} - {symbol}*|"
            svg = line_chart(lines, title, "cost [contact solves]", label, log_x=True, log_y=True)
            parts.append(svg)
    more = len(every) - CONVERGENCE
    note = f"The first {CONVERGENCE} problems; {more} more are not drawn." if more > 0 else ""
    return f'<p class="note">{note}</p><div class="charts">{"".join(parts)}</div>' if parts else ""


def _solves(records: Sequence[Record]) -> str:
    rows = [
        {**record, "time_contact_solves": contact_units(record), "gain_per_cent": gain_in_per_cent(record)}
        for record in records
    ]
    failed = [not record["success"] and record["status"] != "refused" for record in records]

    def table(wanted: tuple[tuple[str, str, str], ...]) -> str:
        shown = [column for column in wanted if any(row.get(column[0]) not in (None, "") for row in rows)]
        head = ["formulation", *(name for _, name, _ in shown)]
        body = [[variant(row), *(_cell(row.get(name), form) for name, _, form in shown)] for row in rows]
        return _table(head, body, texts=2, failed=failed)

    more = f"<details><summary>Residuals and more</summary>{table((*WHICH, *MORE))}</details>"
    return table((*WHICH, *COLUMNS)) + more


def _cell(value: Any, form: str) -> str:
    if value is None or value == "":
        return MISSING
    return str(value) if form == "s" or isinstance(value, str) else format(value, form)


def _failures(records: Sequence[Record]) -> str:
    failed = [record for record in records if not record["success"] and record["status"] != "refused"]
    rows = [
        [variant(r), str(r["example"]), str(r["n"]), str(r["status"]), str(r.get("message") or "")]
        for r in failed
    ]
    return _table(["formulation", "problem", "size", "status", "message"], rows, texts=5) if rows else ""


def _notes(records: Sequence[Record]) -> str:
    found = [*LEGEND, RESIDUALS, *units_notes(records), *stopped_early(records)]
    found += study_notes(records) if is_study(records) else block_notes(records)
    return "<ul>" + "".join(f"<li>{escape(note)}</li>" for note in found) + "</ul>"


def _environment(folder: Path, records: Sequence[Record]) -> str:
    parts, seen = [], set()
    for path in sorted((folder / ROWS).glob("environment-*.json")):
        try:
            entries = {str(k): _flat(v) for k, v in json.loads(path.read_text()).items()}
        except (OSError, ValueError, AttributeError) as error:
            raise BadInputError(f"cannot read {path}: {error}") from error
        text = _list(entries)
        if text not in seen:
            seen.add(text)
            parts.append(text)
    if not parts:
        versions = {_flat(record["versions"]) for record in records if record["versions"]}
        parts = [_list({"versions": version}) for version in sorted(versions)]
    shared = sum(bool(record.get("shared")) for record in records)
    if shared:
        parts.append(
            f'<p class="note">{shared} of {len(records)} solves shared their core with something.</p>'
        )
    return "".join(parts)


def _flat(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {v}" for k, v in value.items())
    return str(value)


def resource(name: str) -> str:
    """A style sheet or script of this package."""
    return files("rmesh_nlp.report").joinpath(name).read_text(encoding="utf-8")
