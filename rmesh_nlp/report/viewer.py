"""Meshes before and after with a slider and fields on hover, as a part of a page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from rmesh_nlp.io.records import Record
from rmesh_nlp.io.results import Result
from rmesh_nlp.io.vtu import Fields, read_vtu
from rmesh_nlp.report.blocks import RELOCATING_NOTHING
from rmesh_nlp.report.study_summary import variant

MESHES = 60
"""Most solves whose meshes are on a page."""


def viewer(results: Sequence[Result]) -> str:
    """The part of a page with a slider between the given and the relocated mesh.

    Raises
    ------
    BadInputError
        If the fields of a solution cannot be read.
    """
    solved = [r for r in results if r.record["energy"] is not None and r.vtu.exists()]
    solved = [r for r in solved if r.record["formulation"] != RELOCATING_NOTHING] or solved
    if not solved:
        return ""
    data = [_mesh(result.record, read_vtu(result.vtu)) for result in solved[:MESHES]]
    left = len(solved) - len(data)
    note = f"{left} further solves are not here; their fields are in the folder solutions." if left else ""
    return (
        f'<p class="note">{note}</p><div id="viewer">'
        '<label>solve <select id="solve"></select> colour <select id="field"></select></label>'
        '<label>given <input id="slider" type="range" min="0" max="1" step="0.01" value="1" '
        'aria-label="from the given to the relocated mesh"> relocated <output id="shown"></output></label>'
        '<canvas></canvas><div class="scale"><span id="low"></span><i></i><span id="high"></span></div>'
        '<div class="hover">Point at a node to read its values.</div></div>'
        f'<script type="application/json" id="meshes-json">{safe_json(data)}</script>'
    )


def _mesh(record: Record, fields: Fields) -> dict[str, Any]:
    size = np.abs(fields.nodes).max() or 1.0
    u = fields.displacement
    values = {"u": u[0]} if u.shape[0] == 1 else {"|u|": np.hypot(*u), "u1": u[0], "u2": u[1]}
    values["contact stress"] = fields.pressure
    if np.any(fields.friction_bound > 0):
        values["tangential stress"] = fields.tangential_stress
    values["motion"] = np.hypot(*(fields.nodes - fields.initial))
    parts = [str(record["example"]), f"n = {record['n']}" if record["n"] else "", variant(record)]
    parts += [f"seed {record['seed']}" if record["seed"] is not None else ""]
    parts += [f"repetition {record['repeat'] + 1}" if record.get("repeat") else ""]

    def rounded(array: Any, unit: float) -> list[float]:
        return [float(f"{value:.5g}") if abs(value) > 1e-12 * unit else 0.0 for value in array]

    return {
        "name": ", ".join(part for part in parts if part),
        "x": rounded(fields.nodes[0], size),
        "y": rounded(fields.nodes[1], size),
        "x0": rounded(fields.initial[0], size),
        "y0": rounded(fields.initial[1], size),
        "t": fields.triangles.T.tolist(),
        "fields": {name: rounded(v, float(np.abs(v).max()) or 1.0) for name, v in values.items()},
    }


def safe_json(value: Any) -> str:
    """JSON that cannot end the script element that it stands in."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
