"""What ``rmesh solve my.toml`` takes by default on a part of one's own, from 400 to 100,000 nodes.

The part is the plate with two holes of ``scripts/gallery/own_parts.py``, clamped over a flat
foundation. Each size is solved twice: with boxes of 0.3 of the shortest edge at a node, as the template
has them, and without boxes. No strategy is named. Every solve is a process of its own on one core, reading,
pictures and files included, and its row is kept in ``own.json``: what is there is not run again. Where the
machine is busy, the time on the processor says more than that on the clock.

    OPENBLAS_NUM_THREADS=1 python scripts/benchmark_own.py --out own
    OPENBLAS_NUM_THREADS=1 python scripts/benchmark_own.py --out own --nodes 400 7000
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent / "gallery"))
import own_parts

NODES = (400, 7000, 24000, 100000)
"""Numbers of nodes that are aimed at."""

BOXES = {"boxes": "delta = { relative = 0.3 }", "none": ""}
"""Line of ``[motion]`` for each kind of row."""

RMESH = "from rmesh_nlp.cli.app import main; main()"


def part(folder: Path, nodes: int, boxes: str) -> Path:
    """Mesh and problem file with about so many nodes."""
    h = (134 / nodes) ** 0.5  # with h = 1 there are 134
    path = own_parts.write("two_holes", folder, h)
    for _ in range(2):
        h *= (_nodes(folder / "two_holes.msh") / nodes) ** 0.5
        path = own_parts.write("two_holes", folder, h)
    path.write_text(path.read_text().replace(BOXES["boxes"], BOXES[boxes]))
    return path


def solve(folder: Path, nodes: int, boxes: str, longest: float) -> dict[str, Any]:
    """One solve in a process of its own: its figures, or how it failed."""
    path, out = part(folder, nodes, boxes), folder / "out"
    words = ["solve", str(path), "--out", str(out), "--quiet", "--time-limit", str(longest)]
    began, before = time.perf_counter(), _children()
    code = subprocess.run([sys.executable, "-W", "ignore", "-c", RMESH, *words], check=False).returncode
    seconds, cpu = time.perf_counter() - began, _children() - before
    try:
        record = json.loads((out / "record.json").read_text())
    except OSError:
        record = {"status": f"exit code {code}"}
    names = ("n", "formulation", "outer", "chosen", "status", "success", "iterations", "contact_solves")
    names += ("energy_initial_audited", "energy_audited", "gain_audited", "wall_time_s", "contact_time_s")
    names += ("build_time_s", "solve_time_s", "audit_time_s")
    return {"aim": nodes, "boxes": boxes, "seconds": seconds, "cpu": cpu} | {k: record.get(k) for k in names}


def _children() -> float:
    times = os.times()
    return times.children_user + times.children_system


def table(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    head = ["nodes", "boxes", "chosen", "status", "iterations", "contact solves", "gain"]
    head += ["processor [s]", "clock [s]"]
    lines = [" | ".join(["", *head, ""]).strip(), "|" + "--:|:--|:--|:--|" + "--:|" * 5]
    for row in sorted(rows, key=lambda row: (row["aim"], row["boxes"])):
        gain = row.get("gain_audited")
        cells = [
            row.get("nodes") or f"about {row['aim']}",
            {"boxes": "0.3 of an edge", "none": "none"}[row["boxes"]],
            ", ".join(str(row[name]) for name in ("formulation", "outer") if row.get(name)),
            row["status"],
            row.get("iterations"),
            row.get("contact_solves"),
            "-" if gain is None else f"{gain:.4g}",
            f"{row['cpu']:.3g}",
            f"{row['seconds']:.3g}",
        ]
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def main(
    out: Path, nodes: Sequence[int] = NODES, boxes: Sequence[str] = tuple(BOXES), longest: float = 600.0
) -> list[dict[str, Any]]:
    """Run what is missing and write ``own.json`` and ``own.md``."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "own.json"
    rows: list[dict[str, Any]] = json.loads(path.read_text()) if path.exists() else []
    for kind in boxes:
        for aim in nodes:
            if any((row["aim"], row["boxes"]) == (aim, kind) for row in rows):
                continue
            row = solve(out / f"{kind}-{aim}", aim, kind, longest)
            rows.append({**row, "nodes": _nodes(out / f"{kind}-{aim}" / "two_holes.msh")})
            path.write_text(json.dumps(rows, indent=1))
            (out / "own.md").write_text(table(rows))
            print(table(rows[-1:]).splitlines()[-1], flush=True)
    return rows


def _nodes(mesh: Path) -> int:
    from rmesh_nlp.meshes import read_mesh

    return int(read_mesh(mesh).p.shape[1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("results/own"))
    parser.add_argument("--nodes", type=int, nargs="+", default=list(NODES))
    parser.add_argument("--boxes", nargs="+", choices=list(BOXES), default=list(BOXES))
    parser.add_argument("--longest", type=float, default=600.0, help="seconds that a solve may take")
    given = parser.parse_args()
    print(table(main(given.out, given.nodes, given.boxes, given.longest)))
