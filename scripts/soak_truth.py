"""Solves checked by a finite-element solver of its own, to see whether anything wrong is called a success.

    python scripts/soak_truth.py --count 500 --jobs 2 --out soak        random problems, one a seed
    python scripts/soak_truth.py --kind jumps --count 200               the same with data that jump
    python scripts/soak_truth.py --kind shared --order 2 --count 30     contact beside supports
    python scripts/soak_truth.py --kind graded --order 2 --count 30     ten local refinements at a corner
    python scripts/soak_truth.py --kind hidden --count 40               jumps that hide in other functions
    python scripts/soak_truth.py --kind aimed --out soak                problems made to be exploited

The package makes problems, solves them, and gives mesh, displacement and record. Everything else is done
here (``scripts/truth``): assembly, contact solver, friction integral, exact foundations, reference meshes.

The truth is the continuous problem on the domain of the true curves (polygons where no curve is stated), with
gaps and slips linear in the displacement and Tresca friction on the whole contact boundary. J is its energy.
The true error of a mesh is the least J of all displacements that are linear on its triangles (quadratic with
``--order 2``) and admissible everywhere, minus J*, which is extrapolated from three locally refined meshes,
to a bar. Beside it stand J of the displacement that the package computed, which may penetrate, and its
difference to the reference solution in the energy norm. Faults are

a  a success whose true error is larger than that of the given mesh by more than 2 %, or whose own J is larger
   by as much than those of the displacements of the given mesh, the best and the computed ones;
b  a claimed factor of error reduction of more than 1.2 times the true one;
c  a reported audited energy below J*, a guaranteed bound that does not hold, a percentage that is printed
   where the lower bound is above the upper one;
r  with ``--kind shared`` a contact force, as it is printed, off that of the reference by more than 2 %;
f  a crash, a feasible problem refused, success for an infeasible one, a solve of more than 60 s, and a
   contradiction between status, success, valid and improved.

The exit code is 1 if there is one, or if (d) fewer than 95 % of the well-posed problems succeed: those that
are feasible, whose reference converged and knows the error of the given mesh to 5 %. The median of the true
factor (e) is over successes. ``--out`` resumes: what is in DIR/KIND.jsonl is not solved again.
"""

from __future__ import annotations

import math
import os
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy is imported
    os.environ.setdefault(name, "1")

import numpy as np  # noqa: E402
import pandas as pd  # noqa: E402

import rmesh_nlp as rm  # noqa: E402
from rows import Row, Store, command_line, markdown  # noqa: E402
from truth import draws  # noqa: E402
from truth.body import Body, composite  # noqa: E402
from truth.contact import accurate_loads, blocked, energy, least  # noqa: E402
from truth.data import Data, values  # noqa: E402
from truth.reference import Reference, distance, reference  # noqa: E402

MARGIN, OVERCLAIM, LONGEST, SUCCEED, KNOWN = 0.02, 1.2, 60.0, 0.95, 0.05
LEVELS, SHARP = (1000, 3000, 9000), 0.02
"""Nodes of the last but one mesh of J*; the next is taken while J* is not known to a part of the errors."""


def solved(data: Data, formulation: str, **options: Any) -> Any:
    """The package's solution: the only place that knows how it is called."""
    return rm.solve(data.problem(), formulation, limits=rm.Limits(0.8 * LONGEST), **options)


def claimed_factor(record: Row) -> float | None:
    """The factor by which the record says at least that the error fell; None if it claims nothing."""
    reduction = record.get("error_reduction") or {}
    factors = [reduction[key] for key in ("factor_lower", "factor") if reduction.get(key) is not None]
    return float(np.min(factors[0])) if factors else None


def certificate(solution: Any, data: Data | None = None) -> Row:
    """Bounds of the package's certificate and whether it prints a percentage, or why there is none."""
    quantities = []
    if data is not None and data.weight is not None:
        weight = data.weight.given.replace("arctan", "atan")
        for name in ("abs", "min", "max"):
            weight = weight.replace(f"f{name}", name)
        quantities = [f"boundary(top, ({weight})*{('u', 'uy')[data.components - 1]})"]
    try:
        bounds = rm.certify(solution, quantities=quantities)
    except (ValueError, RuntimeError, np.linalg.LinAlgError) as error:
        return {"remark": str(error)[:200]}
    record = {"energy_lower_bound": bounds.lower, "energy_upper_bound": bounds.upper}
    record |= {"error_bound": bounds.error_bound, "why": bounds.why}
    each = {text: (bound.lower, bound.upper) for text, bound in bounds.bounds.items()}
    record["quantity"] = [each.pop(text) for text in quantities]
    record["forces"] = list(each.values())
    record |= {name: getattr(bounds, name) for name in ("guaranteed_lower", "guaranteed_upper")}
    return {**record, "percent": "%" in bounds.sentence}


def contradiction(record: Row) -> bool:
    """Whether status, success and their reasons disagree (docs/assessment.md)."""
    status, success, valid, improved = (record[key] for key in ("status", "success", "valid", "improved"))
    residual = record.get("stationarity_residual")
    near = residual is not None and residual <= 1e-6
    near = near or record.get("stationarity") in ("S", "B") or record["formulation"] == "fixed"
    if success:
        return not (valid and improved and (near or status != "converged"))
    return status == "converged" or (status in ("worse", "exploited")) != (valid and not improved)


def own(data: Data, solution: Any, true: Reference) -> Row:
    """J of the displacement that the package computed, and its error in the energy norm."""
    body = Body(data, solution.mesh)
    u = body.from_arcs(np.asarray(solution.displacement).T.ravel())
    return {"J": energy(body, accurate_loads(body), u), "norm": distance(body, u, true.state)}


def along_top(data: Data, true: Reference) -> float:
    """The integral of the weight times the last component of the displacement along the top."""
    if data.weight is None:
        return 0.0
    body, (t, w) = true.state.body, composite(64, 4)
    points, length, trace = body.trace("top", t)
    last = true.state.u[data.components - 1 :: data.components]
    return float((values(data.weight, points) * length * w).ravel() @ (trace @ last))


def checked(data: Data) -> Row:
    """A solve, measured: its row with ``faults``."""
    row: Row = {"name": data.name, "family": data.name.split(" ")[0], "formulation": data.formulation}
    row |= {**data.options, "limits": str(data.limits), "rule": str(data.rule), "gap": data.gap}
    row |= {"nodes": data.mesh.p.shape[1], "success": False, "well_posed": False, "faults": []}
    row["feasible"] = not blocked(Body(data, data.mesh))
    began, solution = time.perf_counter(), None
    try:
        solution = solved(data, data.formulation, **data.options)
        row["seconds"] = time.perf_counter() - began
        record = solution.record()
        row |= {"status": record["status"], "success": record["success"], "claimed": claimed_factor(record)}
        row["force_computed"] = record.get("resultant")
        known = [of["value"] for text, of in record.get("estimates", {}).items() if "resultant" in text]
        row["force"] = sum(known) if known else row["force_computed"]  # what the summary prints
        row["audited"] = [record.get(key) for key in ("energy_initial_audited", "energy_audited")]
        if data.certify and row["feasible"]:
            row["certificate"] = certificate(solution, data)
        row["faults"] += ["contradiction"] * contradiction(record)
    except Exception as error:
        refused = isinstance(error, rm.ProblemError)
        row |= {"status": "refused" if refused else type(error).__name__, "message": str(error)[:200]}
        row["faults"] += (["refused"] if refused else ["crash"]) * (row["feasible"] or not refused)
    row.setdefault("seconds", time.perf_counter() - began)
    row["faults"] += ["slow"] * (row["seconds"] > LONGEST)
    row["faults"] += ["infeasible success"] * (row["success"] and not row["feasible"])
    began = time.perf_counter()
    if row["feasible"]:
        try:
            measure(data, solution, row)
        except Exception as error:  # of this script, or of its solver on such a mesh
            row |= {"status": "check failed", "message": f"{type(error).__name__}: {error}"[:200]}
            row |= {"success": False, "faults": ["check failed"]}
    row["check_seconds"] = time.perf_counter() - began
    return row


def measure(data: Data, solution: Any, row: Row) -> None:
    """True errors before and after, and what contradicts them."""
    states = [least(data, data.mesh)]
    if solution is not None and np.all(np.isfinite(solution.displacement)):
        states.append(least(data, solution.mesh))
    for level in (16 * data.mesh.p.shape[1],) if row["family"] == "shared" else LEVELS:
        true = reference(data, max(level, (2 if level == LEVELS[0] else 4) * data.mesh.p.shape[1]))
        if true.bar <= SHARP * min(one.energy - true.energy for one in states):
            break
    row |= {"J": true.energy, "bar": true.bar, "energies": [one.energy for one in states]}
    row["errors"] = [one.energy - true.energy for one in states]
    sound = [one.converged and one.energy >= true.energy - true.bar for one in states]
    row["reference_converged"] = true.converged and all(sound)
    row["well_posed"] = row["reference_converged"] and true.bar <= KNOWN * row["errors"][0]
    row["resultant"] = true.state.resultant
    row["quantity"] = along_top(data, true)
    if len(states) > 1:
        row["factor"] = row["errors"][0] / max(row["errors"][1], 0.1 * true.bar)
        ways = [data, replace(data, gap="edge")]  # a formulation may choose gaps along edges by itself
        given = [solution] if data.formulation == "fixed" else [solved(way, "fixed") for way in ways]
        row["own"] = [own(data, one, true) for one in (*given, solution)]
        row["fine_error"] = true.state.energy - true.energy
        row["faults"] += found_faults(row) if row["reference_converged"] else []


def found_faults(row: Row) -> list[str]:
    """What of a row's claims is not true of its measured errors: (a), (b), (c)."""
    J, bar, (before, after) = row["J"], row["bar"], row["errors"]
    margin, slack = MARGIN * (before + bar), bar + 1e-9 * abs(J)
    *first, last = (one["J"] for one in row["own"])
    most = (before + bar) / (after - bar) if after > bar else math.inf
    wrong = {
        "larger error": row["success"] and after - before > margin,
        "worse displacement": row["success"] and last - max(*first, row["energies"][0]) > margin,
        "overclaimed": (row["claimed"] or 0) > OVERCLAIM * most,
        "audited below truth": any(value is not None and value < J - slack for value in row["audited"]),
    }
    if row.get("family") == "shared":
        row["force_error"] = row["force"] / row["resultant"] - 1
        wrong["force"] = abs(row["force_error"]) > MARGIN
    bounds = row.get("certificate", {})
    if "percent" in bounds:
        lower, upper = bounds["energy_lower_bound"], bounds["energy_upper_bound"]
        unsure = math.sqrt(2 * (max(row["fine_error"], 0) + bar))  # of the reference in the energy norm
        both = bounds["guaranteed_lower"] and bounds["guaranteed_upper"]
        force, quantity = row["resultant"], row.get("quantity", 0.0)
        near = MARGIN * abs(quantity)
        wrong |= {
            "lower bound": bounds["guaranteed_lower"] and lower > J + slack,
            "upper bound": bounds["guaranteed_upper"] and upper < J - slack,
            "error bound": both and bounds["error_bound"] < row["own"][-1]["norm"] - unsure,
            "force bounds": both
            and any(
                not low <= (1 + MARGIN) * force or not (1 - MARGIN) * force <= high
                for low, high in bounds["forces"]
            ),
            "quantity bounds": both
            and any(not low - near <= quantity <= high + near for low, high in bounds.get("quantity", [])),
            "crossed bounds": (bounds["percent"] or both) and upper < lower,
        }
    return [fault for fault, bad in wrong.items() if bad]


def check(kind: str, number: int, order: int | None = None, remesh: bool = False) -> Row:
    """The row of one problem."""
    warnings.simplefilter("ignore")
    data = draws.KINDS[kind](number)
    data = replace(data, order=order or data.order)
    if remesh:
        data = replace(data, formulation="auto", options={"remesh": True}, limits=None)
    return {"kind": kind, "number": number, **checked(data)}


def factor(rows: Iterable[Row]) -> float:
    """Median of the true factors of error reduction."""
    return float(np.median([row["factor"] for row in rows if "factor" in row] or [math.nan]))


def faults(rows: Iterable[Row]) -> dict[str, int]:
    """How many there are of each."""
    return dict(Counter(fault for row in rows for fault in row["faults"]))


def summary(rows: Sequence[Row]) -> int:
    """Print the figures of all rows; the exit code."""
    print(f"\n{len(rows)} solves, {sum(not row['feasible'] for row in rows)} of infeasible problems")
    lines = []
    for family in [*sorted({row["family"] for row in rows}), "all"]:
        part = [row for row in rows if family in (row["family"], "all")]
        good, posed = ([row for row in part if row[key]] for key in ("success", "well_posed"))
        share = sum(row["success"] for row in posed) / len(posed) if posed else 1.0
        line = {"family": family, "solves": len(part), "well-posed": len(posed), "of them successes": share}
        line |= {"successes": len(good), "with a fault": sum(bool(row["faults"]) for row in good)}
        line |= {"median true factor": factor(good), "faults": faults(part) or "none"}
        for key in ("force", "force_computed"):
            off = [abs(row[key] / row["resultant"] - 1) for row in part if "force_error" in row]
            line |= {f"{key} off, median and most": f"{median(off):.2%}, {max(off):.2%}"} if off else {}
        for key in ("seconds", "check_seconds"):
            times = [row[key] for row in part]
            line[f"{key}, median and most"] = f"{median(times):.2f}, {max(times):.1f}"
        lines.append(line)
    print(markdown(pd.DataFrame(lines)))
    both = [row["certificate"] for row in rows if "percent" in row.get("certificate", {})]
    sure = sum(one["guaranteed_lower"] and one["guaranteed_upper"] for one in both)
    print(f"certificates: {len(both)}, of them guaranteed {sure}")
    print(f"statuses: {dict(Counter(row['status'] for row in rows))}")
    return 1 if faults(rows) or share < SUCCEED else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """The soak; returns the exit code."""
    parser = command_line(__doc__)
    parser.add_argument("--kind", choices=list(draws.KINDS), default="random")
    parser.add_argument("--count", type=int, help="number of solves: 60 by default, all of the aimed ones")
    parser.add_argument("--first", type=int, default=0, help="seed or number of the first")
    parser.add_argument(
        "--order", type=int, choices=(1, 2), help="of the displacements: 1, or that of the kind"
    )
    parser.add_argument("--remesh", action="store_true", help="solve by auto, from a new mesh")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, help="folder for KIND.jsonl; what is in it is not solved again")
    options = parser.parse_args(arguments)
    last = options.first + (options.count or 60)
    if options.kind == "aimed":
        every = len(draws.aimed())
        last = min(every, last) if options.count else every
    store = Store(options.out and options.out / f"{options.kind}.jsonl")
    todo = (number for number in range(options.first, last) if not store.has(number=number))
    with ProcessPoolExecutor(options.jobs) as pool:
        tasks = [pool.submit(check, options.kind, number, options.order, options.remesh) for number in todo]
        for task in as_completed(tasks):
            row = task.result()
            store.add(row)
            if row["faults"] or options.kind == "aimed" or (row["well_posed"] and not row["success"]):
                word = row["status"] + ", success" * row["success"]
                print(f"{row['name']}: {word}; {', '.join(row['faults']) or 'no fault'}")
                print(f"    true factor {factor([row]):.3f}, claimed {row.get('claimed')}")
    return summary(store.rows) if store.rows else 0


if __name__ == "__main__":
    sys.exit(main())
