"""`rmesh solve` on a mesh from gmsh as an analyst would run it, judged from outside.

The plate with two holes of ``scripts/gallery/own_parts.py``, clamped above a flat foundation: loads, supports
and contact are stated and nothing else. Energies before and after are those of the record; the exact one is
computed by quadratic elements of scikit-fem (:mod:`worth.second_order`). The factor that the summary claims
is compared with it.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import own_parts
from worth.rows import Row
from worth.second_order import Plate, energy

from rmesh_nlp.io.problem_file import load_problem

STATED = Plate(young=210000.0, poisson=0.3, traction=(0.0, -600.0), height=-0.02)
"""The same as in the problem file."""


RMESH = "import sys; from rmesh_nlp.cli.app import main; sys.exit(main())"
"""The command ``rmesh`` of this very Python."""


def accepted(h: float, folder: Path, refinements: int = 1) -> Iterator[Row]:
    """Solve by the command line, and compare what it claims with the outside reference.

    Parameters
    ----------
    h : float
        Edge length; 0.62 makes 294 nodes and 0.13 about 5,000.
    """
    path, record_path = folder / "two_holes.toml", folder / "out" / "record.json"
    if not record_path.exists():  # a run that was broken off goes on
        _solved_by_command_line(h, folder)
    record = json.loads(record_path.read_text())
    exact = energy(load_problem(path).mesh, STATED, refinements)
    before, after = (record[key] - exact for key in ("energy_initial_audited", "energy_audited"))
    claimed = record["error_reduction"]
    figures = {
        "error_before": before,
        "factor": before / after,
        "claimed": claimed["factor"],
        "claimed_before": claimed["error_initial"],
        "success": record["success"],
        "status": record["status"],
        "text": claimed["text"],
    }
    nodes, area = claimed["nodes"], record["min_area_ratio"]
    yield Row(
        "acceptance",
        "rmesh solve",
        f"{h:g}",
        nodes,
        after,
        record["wall_time_s"],
        least_area=area,
        figures=figures,
    )


def _solved_by_command_line(h: float, folder: Path) -> None:
    path = own_parts.write("two_holes", folder, h)
    # nothing is said of the motion
    path.write_text(re.sub(r"\n\[motion\]\n[^\[]*", "\n", path.read_text()))
    command = [sys.executable, "-c", RMESH, "solve", str(path), "--out", str(folder / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"rmesh solve ended with {done.returncode}: {done.stdout}{done.stderr}")
