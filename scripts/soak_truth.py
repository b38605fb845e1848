"""Random solves judged by an assembly of its own, to see whether anything wrong is called a success.

    python scripts/soak_truth.py --count 1000 --out soak

Stiffness, loads, gaps and friction are assembled here with numpy, with a rule of degree 19 on each triangle;
the contact problem is solved by its dual, a bounded least-squares problem. Nothing of the package's energies,
contact solver or audit is used. A success with a negative gain, with a gain that differs by more than a tenth
from the one measured here, with a negative gap or an inverted element, or after more than 60 s is reported
and makes the exit code 1. In one draw of fifteen no displacement is admissible: such a problem must be
refused, or at least never be a success. With ``--out`` a run goes on where an earlier one ended.

Rules of quadrature and gaps are drawn too. A coarse rule, or gaps that hold at nodes only over a curved
foundation, is an invitation to cheat, and the honest end of a solve that takes it is no success
(``quadrature-exploited``, ``penetration-exploited``). So shares of successes are printed by rule and by gap,
and over the problems that were stated soundly: a rule chosen for the load, and gaps that hold along the edges
of a curved foundation. Of those at least 95 % must succeed and 90 % converge, else the exit code is 1.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import lsq_linear
from skfem.quadrature import get_quadrature_tri

from rmesh_nlp.api.solving import solve
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import (
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    PlaneStrain,
    PlaneStress,
    Relative,
    Traction,
)

STRATEGIES: tuple[tuple[str, dict[str, Any]], ...] = (
    ("joint", {}),
    ("nested", {"outer": "newton"}),
    ("nested", {"outer": "ipopt"}),
    ("mpcc", {}),
)
BOXES: tuple[Any, ...] = (1e-4, 0.02, 0.1, Relative(0.3), None)
RULES: tuple[str | int, ...] = ("auto", "auto", "midpoint", 4)
GAPS = ("node", "edge")
AGREEMENT, ROUNDING, LONGEST = 0.1, 1e-8, 60.0
BETWEEN = 0.5  # penetration that gaps along edges may leave, as a part of what gaps at nodes would
SUCCEED, CONVERGE = 0.95, 0.9  # least shares of what is stated soundly
POINTS, WEIGHTS = get_quadrature_tri(19)
HARD = ("crash", "slow", "refused", "contradiction")
USABLE = ("converged", "not_stationary", "iteration_limit", "time_limit", "interrupted", "stalled")
BARYCENTRIC = np.vstack([1 - POINTS.sum(axis=0), POINTS])


@dataclass(frozen=True)
class Source:
    """The data of a problem once more, as functions of numpy arrays."""

    load: tuple[Callable[[Any, Any], Any], ...]
    tensor: np.ndarray  # (c, 2, c, 2): energy density 1/2 du : tensor : du
    normal: np.ndarray
    offset: Callable[[Any, Any], Any]
    friction: float
    boundary: str
    gap: str
    curved: bool
    traction: np.ndarray  # (c, 2): values a + b x on the side "top", per component


@dataclass(frozen=True)
class Draw:
    """A random solve: how to state the problem, its data for the judge, and a strategy with its options."""

    problem: Callable[[], ContactProblem]
    source: Source
    strategy: str
    options: dict[str, Any]
    feasible: bool


def wave(a: np.ndarray, lib: Any) -> Callable[[Any, Any], Any]:
    """A load: a polynomial and an oscillation."""
    return lambda x, y: a[0] + a[1] * x * y + a[2] * lib.sin(a[3] * x) * lib.cos(a[4] * y)


def given(
    seed: int, scalar: bool
) -> tuple[tuple[str | Dirichlet, ...], tuple[Traction, ...], np.ndarray, bool]:
    """Supports, tractions on the top, their coefficients (c, 2), and whether a displacement is admissible.

    In one draw of fifteen the supports press a contact node into the foundation.
    """
    rng, n = np.random.default_rng([seed, 1]), 1 if scalar else 2
    values = rng.uniform(-0.5, 0.5, (n, 2)) * rng.integers(2)
    loads = tuple((lambda x, y, a=a, b=b: a + b * x) for a, b in values)
    tractions = (Traction("top", loads),) if np.any(values) else ()
    if rng.integers(15):
        return ("left",), tractions, values, True
    pressed = Dirichlet("top", (-0.2,)) if scalar else Dirichlet("left", (0.0, -0.2))
    held = ("left", pressed) if scalar else (pressed,)
    return held, () if scalar else tractions, values, False


def draw(seed: int) -> Draw:
    """A random solve."""
    rng = np.random.default_rng(seed)
    nx, ny = (int(k) for k in rng.integers(3, 7, 2))
    mesh = rectangle(nx, ny, x=(0, 2), diagonal=("rising", "falling")[rng.integers(2)])
    p = mesh.p.copy()
    inside = mesh.interior_nodes()
    p[:, inside] += rng.uniform(-0.15, 0.15, (2, inside.size)) / max(nx, ny)
    mesh = type(mesh)(p, mesh.t).with_boundaries(
        {
            "left": lambda x: x[0] < 1e-9,
            "right": lambda x: x[0] > 2 - 1e-9,
            "bottom": lambda x: x[1] < 1e-9,
            "top": lambda x: x[1] > 1 - 1e-9,
        }
    )
    smooth = bool(rng.integers(2))
    bend = float(rng.uniform(0, 0.02))
    offset: dict[Any, Callable[[Any, Any], Any]] = {
        lib: (lambda x, y, lib=lib: 0.01 + bend * lib.sin(2 * x) ** 2) for lib in (np, ca)
    }
    gap, curved = GAPS[np.random.default_rng([seed, 2]).integers(2)], False
    laws: list[Any] = []
    coefficients = rng.uniform(-1, 1, (2, 5)) * [1, 1, 0 if smooth else 3, 0, 0] + [0, 0, 0, 5, 4]
    scalar = bool(rng.integers(2))
    if scalar:
        coefficients[0, 0] -= 2
        laws = [Laplace(wave(coefficients[0], ca))]
        tensor = np.eye(2).reshape(1, 2, 1, 2)
        obstacle = Obstacle("right", (1.0,), lambda x, y: 0.01 + bend * ca.sin(2 * x) ** 2, gap=gap)
        normal, friction, boundary = np.ones(1), 0.0, "right"
    else:
        young, poisson = 100.0, float(rng.uniform(0.1, 0.4))
        kind = (PlaneStrain, PlaneStress)[rng.integers(2)]
        coefficients[1, 0] -= 2
        loads = (wave(coefficients[0], ca), wave(coefficients[1], ca))
        laws = [kind.from_young(young, poisson, loads)]
        mu = young / (2 * (1 + poisson))
        lam = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
        if kind is PlaneStress:
            lam = 2 * lam * mu / (lam + 2 * mu)
        d = np.eye(2)
        tensor = (
            lam * np.einsum("ij,kl->ijkl", d, d)
            + mu * np.einsum("ik,jl->ijkl", d, d)
            + mu * np.einsum("il,jk->ijkl", d, d)
        )
        friction = float(rng.choice([0.0, 0.3]))
        obstacle = Obstacle("bottom", (0.0, 1.0), offset[ca], friction, gap=gap)
        curved = True
        normal, boundary = np.array([0.0, 1.0]), "bottom"
    supports, tractions, values, feasible = given(seed, scalar)
    motion, rule = Motion(BOXES[rng.integers(len(BOXES))]), RULES[rng.integers(len(RULES))]

    def problem() -> ContactProblem:
        return ContactProblem(
            mesh,
            laws[0],
            supports,
            obstacle,
            motion,
            tractions=tractions,
            quadrature=rule,
            name=f"random {seed}",
        )

    loads = tuple(wave(a, np) for a in coefficients[: 1 if scalar else 2])
    source = Source(loads, tensor, normal, offset[np], friction, boundary, gap, curved, values)
    name, options = STRATEGIES[rng.integers(len(STRATEGIES))]
    return Draw(problem, source, name, options, feasible)


def kept_off(source: Source, nodes: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """What gaps along edges add at each node: twice the mean height of the arcs beside it (nodes,).

    By Gauss's rule of four points, of the arc of the foundation above its chord, weighted by hat functions;
    arcs that are low beside the others of their edge count less (docs/own_problems.md).
    """
    height, weight = np.zeros(nodes.shape[1]), np.zeros(nodes.shape[1])
    if source.gap == "node":
        return height
    points, weights = np.polynomial.legendre.leggauss(4)
    t, w = (points + 1) / 2, weights / 2
    one, two = nodes[:, edges[0]], nodes[:, edges[1]]
    length = np.linalg.norm(two - one, axis=0)
    at = one[:, :, None] + (two - one)[:, :, None] * t
    ends = [source.offset(*x) * np.ones(length.size) for x in (one, two)]
    chord = ends[0][:, None] * (1 - t) + ends[1][:, None] * t
    arc = np.maximum(chord - source.offset(*at), 0.0)
    typical = np.mean((chord - source.offset(*at)) ** 2, axis=1, keepdims=True)
    part = np.clip(arc**2 / (0.35**2 * typical + 1e-28 * length[:, None] ** 2), 0.0, 1.0)
    arc = arc * part**3 * (10 - 15 * part + 6 * part**2)
    for number, hat in enumerate((1 - t, t)):
        np.add.at(height, edges[number], length * (arc @ (w * hat)))
        np.add.at(weight, edges[number], length / 2)
    return 2 * height / np.where(weight > 0, weight, 1.0)


def depth(source: Source, nodes: np.ndarray, edges: np.ndarray, along: np.ndarray) -> tuple[float, float]:
    """Deepest penetration between contact nodes, and the highest arc, which gaps at nodes may leave.

    ``along`` (nodes,) is the displacement along the normal.
    """
    t = np.linspace(0, 1, 65)
    one, two = nodes[:, edges[0]], nodes[:, edges[1]]
    offset = source.offset(*(one[:, :, None] + (two - one)[:, :, None] * t)) * np.ones((edges.shape[1], 65))
    moved = along[edges[0]][:, None] * (1 - t) + along[edges[1]][:, None] * t
    arc = offset[:, :1] * (1 - t) + offset[:, -1:] * t - offset
    return float(np.max(-(offset + moved), initial=0.0)), float(np.max(arc, initial=0.0))


def energy(problem: ContactProblem, source: Source, nodes: np.ndarray) -> float:
    """The least energy on a mesh, assembled and minimised here."""
    t, c, n = problem.mesh.t, len(source.load), nodes.shape[1]
    v = nodes[:, t]
    jacobian = np.stack([v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]], axis=1).transpose(2, 0, 1)
    area = np.abs(np.linalg.det(jacobian)) / 2
    slopes = np.array([[-1.0, 1, 0], [-1, 0, 1]]).T @ np.linalg.inv(jacobian)  # (elements, 3, 2)
    local = np.einsum("e,eai,picj,ebj->eapbc", area, slopes, source.tensor, slopes)
    dofs = (c * t.T[:, :, None] + np.arange(c)).reshape(t.shape[1], -1)
    K, F = np.zeros((c * n, c * n)), np.zeros(c * n)
    for e, index in enumerate(dofs):
        K[np.ix_(index, index)] += local[e].reshape(index.size, -1)
    where = np.einsum("dae,aq->deq", v, BARYCENTRIC)
    for component, load in enumerate(source.load):
        values = load(where[0], where[1]) * np.ones(where.shape[1:])
        share = np.einsum("e,eq,aq,q->ae", 2 * area, values, BARYCENTRIC, WEIGHTS)
        np.add.at(F, c * t + component, share)
    top = problem.mesh.facets[:, problem.mesh.boundaries["top"]]
    along = np.linalg.norm(nodes[:, top[1]] - nodes[:, top[0]], axis=0)
    for component, (a, b) in enumerate(source.traction):
        one, two = a + b * nodes[0, top]  # at the ends of each edge, linear between them
        np.add.at(F, c * top[0] + component, along * (2 * one + two) / 6)
        np.add.at(F, c * top[1] + component, along * (one + 2 * two) / 6)
    edges = problem.mesh.facets[:, problem.mesh.boundaries[source.boundary]]
    length = np.linalg.norm(nodes[:, edges[1]] - nodes[:, edges[0]], axis=0)
    weight = np.bincount(edges.ravel(), np.tile(length / 2, 2), n)
    held = problem.mesh.facets[:, problem.mesh.boundaries["left"]].ravel()
    contact = np.setdiff1d(np.unique(edges), held)
    free = np.setdiff1d(np.arange(c * n), (c * np.unique(held)[:, None] + np.arange(c)).ravel())
    N = np.zeros((contact.size, c * n))
    N[np.arange(contact.size)[:, None], c * contact[:, None] + np.arange(c)] = source.normal
    gap0 = source.offset(nodes[0, contact], nodes[1, contact]) * np.ones(contact.size)
    gap0 = gap0 - kept_off(source, nodes, edges)[contact]
    bound = source.friction * weight[contact]
    B, c0 = N[:, free], gap0
    lower, upper = np.zeros(contact.size), np.full(contact.size, np.inf)
    T = np.zeros_like(B)
    if source.friction:
        turned = np.zeros_like(N)
        turned[np.arange(contact.size), c * contact] = 1.0  # the tangent of the normal (0, 1)
        T = turned[:, free]
        B, c0 = np.vstack([B, T]), np.append(c0, np.zeros(contact.size))
        lower, upper = np.append(lower, -bound), np.append(upper, bound)
    root = cholesky(K[np.ix_(free, free)], lower=True)
    Y = solve_triangular(root, B.T, lower=True)
    f = solve_triangular(root, F[free], lower=True)
    factor = cholesky(Y.T @ Y, lower=True)
    right = -solve_triangular(factor, Y.T @ f + c0, lower=True)
    y = lsq_linear(factor.T, right, bounds=(lower, upper), method="bvls", tol=1e-14, max_iter=2000).x
    u = solve_triangular(root.T, f + Y @ y)
    return float(0.5 * np.sum((root.T @ u) ** 2) - F[free] @ u + bound @ np.abs(T @ u))


def faults(problem: ContactProblem, source: Source, solution: Any, seconds: float) -> dict[str, Any]:
    """What is wrong with a solution, and the figures measured here."""
    p0, p1 = np.asarray(problem.mesh.p), np.asarray(solution.mesh.p)
    before, after = energy(problem, source, p0), energy(problem, source, p1)
    gain, said = before - after, solution.record()["gain"]
    size = max(abs(before), abs(after))
    edges = problem.mesh.facets[:, problem.mesh.boundaries[source.boundary]]
    held = problem.mesh.facets[:, problem.mesh.boundaries["left"]]
    nodes = np.setdiff1d(edges, held)  # where supports hold a node they give its gap
    along = source.normal @ solution.displacement
    gap = (along + source.offset(p1[0], p1[1]) - kept_off(source, p1, edges))[nodes]
    free = edges[:, ~np.isin(edges, held).any(axis=0)]
    deepest, arc = depth(source, p1, free, along)
    one, two = (np.linalg.det((p[:, t[1:]] - p[:, t[:1]]).transpose(2, 0, 1)) for p, t in
                ((p0, problem.mesh.t), (p1, problem.mesh.t)))  # fmt: skip
    larger = max(abs(gain), abs(said))
    wrong = {
        "negative gain": gain < -ROUNDING * size,
        "gain off": larger > ROUNDING * size and abs(gain - said) > AGREEMENT * larger,
        "infeasible": bool(np.min(gap) < -1e-8 * (1 + np.max(np.abs(gap)))),
        "penetration": source.gap == "edge" and deepest > BETWEEN * arc + 1e-12,
        "inverted": bool(np.min(two / one) <= 0),
        "slow": seconds > LONGEST,
    }
    return {"gain_here": gain, "gain_said": said, "faults": [name for name, bad in wrong.items() if bad]}


def contradicts(record: dict[str, Any]) -> bool:
    """Whether status, success and their reasons disagree (docs/verdict.md)."""
    status, success, valid, improved = (record[name] for name in ("status", "success", "valid", "improved"))
    near = record["stationarity_residual"] is not None and record["stationarity_residual"] <= 1e-6
    near = near or record["stationarity"] in ("S", "B")  # proved where the gradient is not defined
    if success:
        return not (valid and improved and status in USABLE and (near or status != "converged"))
    return status == "converged" or (status == "worse") != (valid and not improved)


def judged(seed: int) -> dict[str, Any]:
    """One solve, its record in short and what is wrong with it."""
    one = draw(seed)
    began = time.perf_counter()
    row: dict[str, Any] = {"seed": seed, "strategy": one.strategy, **one.options, "feasible": one.feasible}
    row.update(gap=one.source.gap, curved=one.source.curved)
    try:
        problem = one.problem()
        row.update(rule=str(problem.quadrature), box=str(problem.motion.delta))
        solution = solve(problem, one.strategy, time_limit_s=0.8 * LONGEST, **one.options)
        row["seconds"] = time.perf_counter() - began
        row.update(status=solution.status.value, success=solution.success)
        row.update(residual=solution.stationarity_residual)
        row.update(faults(problem, one.source, solution, row["seconds"]) if one.feasible else {"faults": []})
        if contradicts(solution.record()):
            row["faults"] = [*row["faults"], "contradiction"]
    except ProblemError as error:
        row.update(status="refused", message=str(error), success=False)
        row.update(faults=["refused"] if one.feasible else [])
    except Exception as error:
        row.update(status=f"{type(error).__name__}: {error}", success=False, faults=["crash"])
    row.setdefault("seconds", time.perf_counter() - began)
    if row["success"] and not one.feasible:
        row["faults"] = [*row["faults"], "infeasible"]
    return row


def run(count: int, first: int, out: Path | None, longest: float) -> int:
    """The soak; returns the exit code. It ends early after ``longest`` seconds."""
    began, rows = time.perf_counter(), []
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        rows = read(out)
    done = {row["seed"] for row in rows}
    for seed in range(first, first + count):
        if seed in done:
            continue
        if time.perf_counter() - began > longest:
            print(f"stopped before seed {seed}")
            break
        row = judged(seed)
        rows.append(row)
        if (row["feasible"] and (not row["success"] or row["faults"])) or set(HARD) & set(row["faults"]):
            print(json.dumps(row), flush=True)
        if out is not None:
            with (out / "soak.jsonl").open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    return summary(rows)


def read(out: Path) -> list[dict[str, Any]]:
    """Rows of earlier runs."""
    file = out / "soak.jsonl"
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def summary(rows: list[dict[str, Any]]) -> int:
    """Print the figures; 1 if a success is wrong, a solve crashed or took too long."""
    feasible = [row for row in rows if row["feasible"]]
    impossible = [row for row in rows if not row["feasible"]]
    wrong = Counter(fault for row in rows if row["success"] for fault in row["faults"])
    hard = Counter(fault for row in rows for fault in row["faults"] if fault in HARD)
    slowest = max(rows, key=lambda row: row["seconds"])
    print(f"{len(rows)} solves, {len(feasible)} of feasible problems, {len(impossible)} of infeasible ones")
    print(f"slowest {slowest['seconds']:.1f} s (seed {slowest['seed']})")
    print(f"infeasible: {dict(Counter(row['status'] for row in impossible))}")
    exact = [row for row in feasible if row.get("rule") == "auto"]
    sound = [row for row in exact if row["gap"] == "edge" or not row["curved"]]
    shares = {
        name: share(name, part)
        for name, part in (
            ("feasible", feasible),
            *((f"  rule {rule}", [row for row in feasible if row.get("rule") == rule]) for rule in rules()),
            *(
                (f"  rule auto, {'curved' if curved else 'flat'} foundation, gap {gap}",
                 [row for row in exact if (row["curved"], row["gap"]) == (curved, gap)])
                for curved in (False, True)
                for gap in GAPS
            ),
            ("stated soundly", sound),
        )
    }  # fmt: skip
    successes, converged = shares["stated soundly"]
    short = bool(sound) and (successes < SUCCEED or converged < CONVERGE)
    for outer in sorted({f"{row['strategy']} {row.get('outer', '')}".strip() for row in feasible}):
        part = [row for row in feasible if f"{row['strategy']} {row.get('outer', '')}".strip() == outer]
        seconds = sorted(row["seconds"] for row in part)
        print(
            f"  {outer}: {dict(Counter(row['status'] for row in part))}, "
            f"median {seconds[len(seconds) // 2]:.1f} s, most {seconds[-1]:.1f} s"
        )
    print(f"false successes: {sum(bool(row['faults']) for row in rows if row['success'])}")
    for fault in ("negative gain", "gain off", "infeasible", "penetration", "inverted", "slow"):
        print(f"  {fault}: {wrong[fault]}")
    print(f"crashes, refused problems, slow solves, contradictions: {dict(hard) or 'none'}")
    return 1 if wrong or hard or short else 0


def rules() -> list[str]:
    """Names of the rules that are drawn."""
    return list(dict.fromkeys(map(str, RULES)))


def share(name: str, part: list[dict[str, Any]]) -> tuple[float, float]:
    """Print and return the shares of successes and of converged solves."""
    good = sum(row["success"] for row in part)
    met = sum(row["status"] == "converged" for row in part)
    n = max(len(part), 1)
    print(f"{name}: {good} of {len(part)} ({good / n:.1%}) successes, {met} ({met / n:.1%}) converged")
    return good / n, met / n


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--count", type=int, default=60, help="number of solves")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument(
        "--out", type=Path, help="folder for soak.jsonl; seeds that are in it are not solved again"
    )
    parser.add_argument("--longest", type=float, default=float("inf"), help="seconds after which to stop")
    arguments = parser.parse_args()
    sys.exit(run(arguments.count, arguments.first, arguments.out, arguments.longest))
