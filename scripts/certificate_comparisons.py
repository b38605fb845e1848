"""Brackets of random problems beside those of finer grids: whether they overlap, and how close they are."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skfem import MeshTri

import formulations.fixed
import formulations.joint
import formulations.nested
from rmesh_nlp.certificate.bracket import Bracket
from rmesh_nlp.certificate.conditions import NotCertifiableError
from rmesh_nlp.certificate.refined import refined_bracket
from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.examples.random_problems import STILL, Frame, random_problem
from rmesh_nlp.meshes.geometry import signed_areas
from rmesh_nlp.problem import ContactProblem, Obstacle
from rmesh_nlp.solving.certify import contact_solution

KINDS = ("scalar", "membrane", "elastic", "rough")
FINER = 2
"""Uniform refinements to the grid that says where the least energy is."""


def bracket_of(problem: ContactProblem, refinements: int | None = None) -> Bracket:
    """The bracket by the contact solution on the mesh of a problem, as `certify` has it."""
    nodes = problem.mesh.p
    return refined_bracket(problem, nodes, contact_solution(ContactModel(problem), nodes), refinements)


def graded(mesh: MeshTri, power: float) -> MeshTri:
    """A mesh of height 1 with its rows drawn towards the bottom."""
    p = mesh.p.copy()
    p[1] = np.sign(p[1]) * np.abs(p[1]) ** power
    return replace(mesh, doflocs=p)


def problem_of(seed: int, kind: str) -> ContactProblem:
    """A random problem on a distorted, graded and turned mesh, over a straight foundation."""
    rng = np.random.default_rng(10_000 + seed)
    angle = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    frame = Frame(turn, rng.uniform(-1, 1, 2)) if kind in KINDS[2:] and seed % 2 else STILL
    problem = random_problem(seed, frame, kind)
    back = frame.turn.T @ (problem.mesh.p - frame.shift[:, None])
    power = rng.choice([1.0, 2.0, 4.0])
    mesh = replace(problem.mesh, doflocs=back)
    if mesh.subdomains is None:
        mesh = graded(mesh, power)
    mesh = replace(mesh, doflocs=frame.turn @ mesh.p + frame.shift[:, None])
    if np.min(signed_areas(mesh.p, problem.triangles)) <= 0:
        mesh = problem.mesh
    if kind in KINDS[2:]:
        a, b = rng.uniform(0.015, 0.025), rng.uniform(-0.002, 0.002)
        old = problem.obstacle
        assert isinstance(old, Obstacle)
        gap = frame.scalar(lambda x, y: y + a + b * x)
        problem = replace(problem, obstacle=Obstacle(old.boundary, old.normal, gap, old.friction))
    return replace(problem, mesh=mesh)


@dataclass(frozen=True)
class Comparison:
    """A bracket beside that of a finer grid."""

    violated: bool
    ratio: float | None


def compared(rough: Bracket, fine: Bracket) -> Comparison:
    """Whether two brackets of one problem overlap, and the gap of the first over the true one."""
    violated = (rough.guaranteed_lower and fine.guaranteed_upper and rough.lower > fine.upper) or (
        rough.guaranteed_upper and fine.guaranteed_lower and rough.upper < fine.lower
    )
    least, known = max(rough.lower, fine.lower), min(rough.upper, fine.upper)
    true = rough.upper - (least + known) / 2
    ratio = (rough.upper - rough.lower) / true if known - least <= 0.2 * true else None
    return Comparison(bool(violated), ratio)


Row = dict[str, Any]
"""What is known of one random problem: kind, seed, moved, and the figures of its brackets."""


def random_row(kind: str, seed: int, moved: bool) -> Row:
    """One random problem against the grid that is 16 times as fine."""
    problem = problem_of(seed, kind)
    row: Row = {"kind": kind, "seed": seed, "moved": moved}
    if moved:
        solution = formulations.joint.solve(problem)
        if not solution.audit.min_area_ratio > 0:
            return {**row, "refused": "no valid relocated mesh"}
        problem = replace(problem, mesh=solution.mesh)
    row["aspect"] = float(np.max(aspects(problem.mesh)))
    row["materials"] = len(problem.laws)
    try:
        rough = bracket_of(problem)
        fine = bracket_of(replace(problem, mesh=problem.mesh.refined(FINER)), 1)
    except NotCertifiableError as error:
        return {**row, "refused": str(error)}
    found = compared(rough, fine)
    return {
        **row,
        "violated": found.violated,
        "ratio": found.ratio,
        "lower": rough.guaranteed_lower,
        "upper": rough.guaranteed_upper,
        "residual": rough.residual,
        "why": "; ".join(rough.why),
    }


def aspects(mesh: MeshTri) -> NDArray[np.float64]:
    """(elements,) longest edge over the height on it."""
    corners = mesh.p[:, mesh.t]
    longest = np.max(np.sum((corners - np.roll(corners, 1, axis=1)) ** 2, axis=0), axis=0)
    return np.asarray(longest / (2 * np.abs(signed_areas(mesh.p, mesh.t))))


def random_part(
    kinds: Sequence[str], seeds: Sequence[int], relocate_every: int, keep: Path | None = None
) -> int:
    """Random problems of each kind; returns the number of violations.

    With a file the rows are added to those that it has, problems that it has are not computed
    again, and the table is of all of them.
    """
    rows: list[Row] = []
    if keep is not None and keep.exists():
        rows = [json.loads(line) for line in keep.read_text().splitlines()]
    done = {(row["kind"], row["seed"], row["moved"]) for row in rows}
    for kind in kinds:
        for moved in (False, True):
            for seed in seeds:
                if (moved and seed % relocate_every) or (kind, seed, moved) in done:
                    continue
                rows.append(random_row(kind, seed, moved))
                if keep is not None:
                    with keep.open("a") as file:
                        file.write(json.dumps(rows[-1]) + "\n")
    return report(rows)


def report(rows: Sequence[Row]) -> int:
    """The table of random problems; returns the number of violations."""
    print("\nratio: computed over true gap, where the finer grid knows the true one")
    print(
        "kind                 problems  violated  lower guaranteed  upper  residual  worst aspect"
        "  ratio: least, 10 %, median, 90 %, 99 %, worst (of)"
    )
    for kind in KINDS:
        for moved in (False, True):
            some = [row for row in rows if row["kind"] == kind and row["moved"] == moved]
            found = [row for row in some if "refused" not in row]
            for row in some:
                if "refused" in row:
                    print(f"{kind}, seed {row['seed']}: no certificate: {row['refused']}")
            if found:
                print(report_line(f"{kind}{', relocated' if moved else ''}", found))
    for row in rows:
        if row.get("why"):
            print(f"{row['kind']}, seed {row['seed']}{', relocated' * row['moved']}: {row['why']}")
    return sum(row.get("violated", False) for row in rows)


def report_line(name: str, rows: Sequence[Row]) -> str:
    """One line of the table of random problems."""
    ratios = [row["ratio"] for row in rows if row["ratio"] is not None]
    shown = ", ".join(f"{x:.2f}" for x in np.quantile(ratios, (0, 0.1, 0.5, 0.9, 0.99, 1))) if ratios else "-"
    wrong, lower, upper = (sum(row[key] for row in rows) for key in ("violated", "lower", "upper"))
    residual, aspect = (max(row[key] for row in rows) for key in ("residual", "aspect"))
    return (
        f"{name:20s} {len(rows):8d} {wrong:9d} {lower:17d} {upper:6d} {residual:9.0e} {aspect:13.0f}"
        f"  {shown} ({len(ratios)})"
    )
