"""Random problems without boxes, solved by ``auto``: all must be successes, none with a higher energy.

    python scripts/soak_moves.py --seeds 0:20 --out moves
    python scripts/soak_moves.py --seeds 13:30 --agree

Bodies are rectangles, L-shapes, wedges, plates with a hole, discs and random polygons, with 40 to 300 nodes;
all but the rectangles are meshed by gmsh. Laws, loads (smooth and steep), supports, foundations (flat,
inclined, curved, discs, in the interior) and friction are drawn too. ``records.jsonl`` has a line for each
seed; one that is there already is not solved again. The exit code is 1 if a solve is no success, ends
with a higher audited energy, or takes more than 200 contact solves.

``--agree`` solves them by ``joint`` and by ``nested``, each from the mesh as given and with the same weights
of the distortion, and prints by how much of the gain their audited energies differ.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from skfem import MeshTri

from support.formulations import auto, joint, nested
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.meshes.shapes import half_disc, l_shape, plate_with_hole, polygon, rectangle, wedge_block
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    PlaneStrain,
    PlaneStress,
    Traction,
)

MOST = 200
"""Contact solves that one problem may take."""

ROUNDING = 1e-10

WEIGHTS = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Of the distortion, where ``joint`` and ``nested`` are compared."""

ALIKE = 0.005
"""Difference of two energies, in parts of the gain, up to which they count as alike."""


def scalar_problem(rng: np.random.Generator) -> ContactProblem:
    """A membrane: over an obstacle, or with contact on a part of its boundary."""
    c = rng.uniform(-1, 1, 8)
    kind = rng.integers(3)
    if kind == 0:
        n = int(rng.integers(6, 13))
        mesh, held, contact = (
            rectangle(n, n, diagonal=("rising", "falling")[rng.integers(2)]),
            "left",
            "right",
        )
    elif kind == 1:
        mesh, held, contact = l_shape(rng.uniform(0.12, 0.25)), "outer", "corner"
    else:
        mesh, held, contact = _random_polygon(rng)
    steep = 1 + 9 * rng.random()

    def source(x: Any, y: Any) -> Any:
        bump = ca.exp(-steep * ((x - 0.5 * c[0]) ** 2 + (y - 0.5 * c[1]) ** 2))
        return -1 + 3 * c[2] * bump + c[3] * ca.sin(3 * x + c[4]) * ca.cos(4 * y)

    law = Laplace(source, 1.0 + 0.5 * c[5])
    if rng.integers(2):
        obstacle = Obstacle.interior(lambda x, y: -0.03 - 0.02 * c[6] - 0.1 * (x**2 + y**2))
    else:
        obstacle = Obstacle(contact, (1.0,), lambda x, y: 0.02 * (1 + c[6]) + 0.01 * x * y)
    return ContactProblem(mesh, law, (held,), obstacle, Motion(None), name="scalar")


def elastic_problem(rng: np.random.Generator) -> ContactProblem:
    """A body that is pressed onto a foundation."""
    c = rng.uniform(-1, 1, 10)
    young, poisson = 10 ** rng.uniform(2, 5), rng.uniform(0.0, 0.4)
    law = (PlaneStrain, PlaneStress)[rng.integers(2)].from_young(young, poisson)
    load = young * 10 ** rng.uniform(-3.5, -2)
    kind = rng.integers(5)
    curves: dict[str, Any] = {}
    supports: tuple[str | Dirichlet, ...] = (Dirichlet("left", (0.0, None)),)
    if kind == 0:
        n = int(rng.integers(5, 10))
        mesh, contact, loaded, size = rectangle(2 * n, n, x=(0, 2)), "bottom", "top", 2.0
    elif kind == 1:
        mesh, contact, loaded = wedge_block(rng.uniform(0.2, 0.35)), "wedge", "top"
        size = 4.0
    elif kind == 2:
        mesh, contact, loaded, size = plate_with_hole(rng.uniform(0.9, 1.8)), "bottom", "top", 10.0
        curves = {"hole": Circle((5.0, 5.0), 2.5)} if rng.integers(2) else {}
    elif kind == 3:
        mesh = half_disc(rng.uniform(0.15, 0.3), contact=0.3, h_contact=rng.uniform(0.04, 0.08))
        contact, loaded, size = "contact", "top", 1.0
        supports = (Dirichlet("axis", (0.0, None)),)
    else:
        mesh, held, contact = _random_polygon(rng)
        supports, loaded, size = (held,), "far", 2.0
    middle, low = size * (0.5 + 0.2 * c[0]), float(np.min(mesh.p[1]))
    friction: Any = 0.0 if rng.integers(2) else load * 0.3 * (1 + rng.random())
    if friction and kind == 3:
        friction = 0.0  # not on an axis of symmetry, where the tangent turns
    elif friction and kind < 3:
        supports = ("left",)
    gap = size * 1e-3 * (1 + c[1])
    shape = rng.integers(4) if kind != 3 else 3
    if shape == 0:
        obstacle = Obstacle.graph(contact, low - gap, friction)
    elif shape == 1:
        bend = 10 ** rng.uniform(-3, -1.2) / size
        obstacle = Obstacle.graph(contact, lambda x, y: low - gap - bend * (x - middle) ** 2, friction)
    elif shape == 2:
        radius = size * rng.uniform(2, 8)
        obstacle = Obstacle.circle(contact, (middle, low - gap - radius), radius, friction=friction)
    elif kind == 3:
        obstacle = Obstacle.graph(contact, lambda x, y: y - 1 + ca.sqrt(1 - x**2), friction)
    else:
        obstacle = Obstacle.line(contact, (0, low - gap), (0.02 * c[2], 1), friction)
    if kind == 4:
        obstacle = Obstacle.line(contact, (0.0, low - gap), (0.0, 1.0), friction)

    def down(x: Any, y: Any) -> Any:
        return -load * (1 + 0.8 * c[3] * ca.sin((3 + 2 * c[4]) * x / size))

    tractions = (Traction(loaded, (0.3 * load * c[5], down)),)
    motion = Motion(None, curves=curves)
    return ContactProblem(mesh, law, supports, obstacle, motion, tractions, name="elastic")


def _random_polygon(rng: np.random.Generator) -> tuple[MeshTri, str, str]:
    """A convex polygon of five to seven corners: held at one edge, contact on another, the rest is far."""
    corners = int(rng.integers(5, 8))
    angles = 2 * np.pi * (np.arange(corners) + rng.uniform(-0.25, 0.25, corners)) / corners - np.pi / 2
    angles -= (angles[0] + angles[1]) / 2 + np.pi / 2  # the first edge is below
    points = [(float(np.cos(a)), float(np.sin(a))) for a in angles]
    level = (points[0][1] + points[1][1]) / 2
    points[0], points[1] = (points[0][0], level), (points[1][0], level)
    far = [i for i in range(corners) if i not in (0, corners // 2)]
    names = {"below": [0], "held": [corners // 2], "far": far}
    return polygon(points, float(rng.uniform(0.18, 0.35)), names), "held", "below"


def drawn(seed: int) -> ContactProblem:
    """The problem of a seed."""
    rng = np.random.default_rng([20261122, seed])
    problem = scalar_problem(rng) if rng.random() < 0.35 else elastic_problem(rng)
    return replace(problem, name=f"{problem.name}-{seed}")


def solved(seed: int, options: dict[str, Any]) -> dict[str, Any]:
    """What came of one seed."""
    began = time.process_time()
    try:
        problem = drawn(seed)
    except ProblemError as error:
        return {"seed": seed, "status": "refused", "message": str(error), "refused": True}
    row: dict[str, Any] = {"seed": seed, "name": problem.name, "nodes": int(problem.mesh.p.shape[1])}
    try:
        record = auto.solve(problem, **options).record()
    except ProblemError as error:
        return {**row, "status": "refused", "message": str(error), "refused": True}
    except Exception as error:  # a traceback is what is looked for
        return {**row, "status": f"{type(error).__name__}: {error}", "success": False, "faults": ["crash"]}
    row |= {
        name: record.get(name)
        for name in (
            "status",
            "success",
            "valid",
            "contact_solves",
            "iterations",
            "gain_audited",
            "energy_initial_audited",
            "energy_audited",
            "penetration",
            "min_area_ratio",
            "stationarity_residual",
            "gain_estimate",
            "warnings",
            "chosen",
        )
    }
    size = max(abs(row["energy_initial_audited"]), 1e-300)
    faults = [] if row["success"] else ["no success"]
    faults += [] if row["gain_audited"] >= -ROUNDING * size else ["higher energy"]
    faults += [] if row["contact_solves"] <= MOST else ["contact solves"]
    return {**row, "seconds": round(time.process_time() - began, 2), "faults": faults}


def agreement(seed: int) -> dict[str, Any]:
    """How far ``joint`` and ``nested`` end from each other; positive where ``nested`` is lower."""
    try:
        problem = with_edge_gaps(drawn(seed))
    except ProblemError as error:
        return {"seed": seed, "refused": str(error)}
    one, two = (
        strategy.solve(problem, regularisation=WEIGHTS, time_limit_s=120.0) for strategy in (joint, nested)
    )
    energies = [solution.audit.energy_audited for solution in (one, two)]
    gain = one.energy_initial_audited - min(energies)
    return {
        "seed": seed,
        "name": problem.name,
        "nodes": int(problem.mesh.p.shape[1]),
        "iterations": [one.iterations, two.iterations],
        "status": [one.status.value, two.status.value],
        "difference": (energies[0] - energies[1]) / gain if gain > 0 else 0.0,
    }


def agree(seeds: range) -> int:
    """Print the differences; the exit code is 1 if more than one in ten is large."""
    rows = []
    for row in map(agreement, seeds):
        print(json.dumps(row), flush=True)
        rows += [row] if "name" in row else []
    close = sum(abs(row["difference"]) <= ALIKE for row in rows)
    print(f"{close} of {len(rows)} within {ALIKE:.1%} of the gain")
    return int(close < 0.9 * len(rows))


def main(arguments: list[str] | None = None) -> int:
    """Solve the seeds; print counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="0:20", help="first:last, the last one not included")
    parser.add_argument("--out", type=Path, default=Path("moves"))
    parser.add_argument("--seconds", type=float, default=float("inf"), help="no new problem after so long")
    parser.add_argument("--agree", action="store_true", help="compare joint with nested instead")
    given = parser.parse_args(arguments)
    first, last = (int(part) for part in given.seeds.split(":"))
    if given.agree:
        return agree(range(first, last))
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "records.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    rows = {row["seed"]: row for row in map(json.loads, lines)}
    began = time.monotonic()
    with path.open("a") as file:
        for seed in range(first, last):
            if seed in rows or time.monotonic() - began > given.seconds:
                continue
            rows[seed] = solved(seed, {})
            file.write(json.dumps(rows[seed]) + "\n")
            file.flush()
            if rows[seed].get("faults"):
                print(json.dumps(rows[seed]), flush=True)
    done = [rows[seed] for seed in range(first, last) if seed in rows]
    tried = [row for row in done if not row.get("refused")]
    solves = [row["contact_solves"] for row in tried if row.get("contact_solves") is not None]
    faulty = [row for row in tried if row["faults"]]
    print(
        f"{len(tried)} problems ({len(done) - len(tried)} refused before a solve), "
        f"{sum(bool(row['success']) for row in tried)} successes, "
        f"{sum(row['status'] == 'converged' for row in tried)} converged, "
        f"{sum('higher energy' in row['faults'] for row in tried)} with a higher energy; contact solves "
        f"{np.median(solves) if solves else 0:.0f} in the median and {max(solves, default=0)} at most"
    )
    return 1 if faulty else 0


if __name__ == "__main__":
    sys.exit(main())
