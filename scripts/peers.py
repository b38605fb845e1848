"""One solver on one problem, ours or a peer: the process that ``benchmark_peers.py`` starts for each run.

    python scripts/peers.py "joint/Pyomo, Ipopt" --n 8 --answer answer.jsonl

Writes one line of JSON per problem. A peer is imported where it is used, so that none is needed. Where a
peer stopped is judged by our own contact solve, or by the expressions of the MPCC, never by its own word.
Timed is everything from the stated problem to the solver's end; not timed are imports, a first solve on a
grid of 3 x 3 squares (it loads Ipopt), the contact solve on the initial grid that peers of ``joint`` start
from, and the judging.
"""

from __future__ import annotations

import argparse
import json
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from benchmark_mpcc import load, relative_error
from peer_solvers.at_once import SILENT, nlpsol_mapped, nlpsol_written_out, ours_joint, pyomo_model
from peer_solvers.case import Answer, Case, Finish
from peer_solvers.mpccs import mpecss, ours_mpcc, pympcc, scholtes_loop
from peer_solvers.nested import ours_nested, scipy_minimize
from peer_solvers.plate import neurom, plate

from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem, signed_areas

REACHED, FEASIBLE = 1e-4, 1e-3
"""Largest error of the objective, and violation and min(G, H), of an MPCC that counts as solved.

The second is loose: solvers that stop at G H <= 1e-7 leave some 3e-4 where both are small.
"""

Relocate = Callable[[Case], Finish]
SolveMpcc = Callable[[Mapping[str, Any]], tuple[Array, str]]

JOINT: dict[str, Relocate] = {
    "rmesh_nlp joint": ours_joint,
    "CasADi nlpsol, written out": nlpsol_written_out,
    "CasADi nlpsol, our expressions": nlpsol_mapped,
    "Pyomo, Ipopt": pyomo_model,
}
NESTED: dict[str, Relocate] = {
    f"rmesh_nlp nested, {outer}": ours_nested(outer) for outer in ("newton", "newton-pair")
} | {
    f"SciPy {method}, {name}": scipy_minimize(method, derivative)
    for derivative, name in (("gradient", "our gradient"), ("2-point", "finite differences"))
    for method in ("SLSQP", "trust-constr", "L-BFGS-B")
}
PLATES: dict[str, Relocate] = {"rmesh_nlp joint": ours_joint, "NeuROM-Py": neurom}
MPCCS: dict[str, SolveMpcc] = {
    "rmesh_nlp.mpcc": ours_mpcc,
    "plain Scholtes loop on nlpsol": scholtes_loop,
    "MPECSS": mpecss,
    "pympcc": pympcc,
}
GROUPS: dict[str, Mapping[str, Any]] = {"joint": JOINT, "nested": NESTED, "plate": PLATES, "mpcc": MPCCS}
"""Solvers by group, ours first."""


def judged(problem: ContactProblem, finish: Finish) -> Answer:
    """Energy of an exact contact solve and least element area over its initial value."""
    areas = signed_areas(finish.nodes, problem.triangles) / signed_areas(problem.mesh.p, problem.triangles)
    least = float(np.min(areas))
    energy = ContactModel(problem).solve(finish.nodes).energy if least > 0 else None
    return Answer(finish.status, finish.seconds, energy=energy, least_area=least)


def is_solved(problem: Mapping[str, Any], x: Array) -> bool:
    """Whether a point is at the target, feasible and complementary."""
    expressions = [problem[key] for key in ("f", "g", "G", "H")]
    values = ca.Function("all", [problem["x"]], expressions)(x)
    f, g, G, H = (np.asarray(value.full()).ravel() for value in values)
    bounds = (np.asarray(problem[key], dtype=float) for key in ("lbx", "ubx", "lbg", "ubg"))
    lbx, ubx, lbg, ubg = bounds
    excess = np.concatenate([lbx - x, x - ubx, lbg - g, g - ubg, -G, -H, np.minimum(G, H)])
    error = relative_error(float(f[0]), problem["target"])
    return bool(error <= REACHED and np.max(excess) <= FEASIBLE)


def mpcc_answers(solver: SolveMpcc, collection: Path, skip: int, limit: float) -> Iterator[Answer]:
    """One answer per problem of a collection, without the first ``skip``.

    A problem that takes longer than ``limit`` ends the process by a signal, also inside compiled code.
    """
    module = load(collection)
    warm = ca.SX.sym("warm")
    ca.nlpsol("warm", "ipopt", {"x": warm, "f": warm**2}, SILENT)(x0=1)
    for name in module.names()[skip:]:
        problem = module.get(name)
        signal.setitimer(signal.ITIMER_REAL, limit if np.isfinite(limit) else 0)
        began = time.perf_counter()
        try:
            x, status = solver(problem)
        except Exception as error:  # a peer's failure is a result
            seconds = time.perf_counter() - began
            yield Answer(type(error).__name__, seconds, failed=True, solved=False)
            continue
        seconds = time.perf_counter() - began
        signal.setitimer(signal.ITIMER_REAL, 0)
        yield Answer(status, seconds, solved=is_solved(problem, x))


def answers(options: argparse.Namespace) -> Iterator[Answer]:
    """What one solver gives."""
    group, name = options.solver.split("/", 1)
    solver = GROUPS[group][name]
    if group == "mpcc":
        yield from mpcc_answers(solver, options.collection, options.skip, options.limit)
        return
    mesh = options.plate if group == "plate" else None
    problem = EXAMPLES["6.1"](options.n) if mesh is None else plate(mesh)
    warm = ours_joint if mesh is not None else solver
    warm(Case(EXAMPLES["6.1"](3)))
    yield judged(problem, solver(Case(problem, mesh, options.limit)))


def main() -> None:
    """Run one solver and write its answers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("solver", help="GROUP/NAME")
    parser.add_argument("--n", type=int, default=8, help="squares per side of Example 6.1")
    parser.add_argument("--plate", type=Path)
    parser.add_argument("--collection", type=Path)
    parser.add_argument("--skip", type=int, default=0)
    parser.add_argument("--limit", type=float, default=float("inf"))
    parser.add_argument("--answer", type=Path, required=True)
    options = parser.parse_args()
    with options.answer.open("w", encoding="utf-8") as file:
        for answer in answers(options):
            print(json.dumps(asdict(answer)), file=file, flush=True)


if __name__ == "__main__":
    main()
