"""Whether the bounds hold, how close they are, and what they cost.

    OPENBLAS_NUM_THREADS=1 python scripts/benchmark_certificate.py
    OPENBLAS_NUM_THREADS=1 python scripts/benchmark_certificate.py --parts large

exact        Example 6.1, whose least energy is known, before and after relocation.
random       Problems and meshes of random kind, distorted, graded to elements of 1:100, turned, with friction
             and several materials. The least energy is taken from a grid of 16 times as many elements with
             its own bracket. A violation is a lower bound above an upper bound of the fine grid, or an upper
             one below a lower one. Ratios are computed over true gap, the true one by the middle of the fine
             bracket, where that is known to a tenth. Every so many problems are relocated first.
objective    Meshes of least certified bound (``objective="certificate"``) beside meshes of least energy.
cost         Process time of a bracket over that of a contact solve with its assembly, medians of three.
degradation  Nearly incompressible bodies and thin elements.
peers        The least energy by extrapolation of energies from three grids, beside the bracket.
large        One elastic problem of 51,200 triangles: seconds and memory.

Ends with code 1 if a bound is violated.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from certificate_comparisons import FINER, KINDS, bracket_of, compared, random_part
from matplotlib import rc_context
from skfem import MeshTri

import formulations.fixed
import formulations.joint
import formulations.nested
from rmesh_nlp.certificate.bracket import bracket
from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.examples.paper import EXACT_ENERGY_61
from rmesh_nlp.examples.random_problems import random_problem
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Obstacle, PlaneStrain, Traction
from rmesh_nlp.report.errors import bracket_figure
from rmesh_nlp.report.style import SETTINGS, save
from rmesh_nlp.solving.certify import certify, contact_solution


def exact_part(sizes: Sequence[int], figure: Path | None) -> int:
    """Example 6.1 against its exact least energy; returns the number of violations."""
    records = []
    print(f"\nExample 6.1, exact least energy {EXACT_ENERGY_61:.10f}")
    print("   n  strategy        lower        upper  computed/true  error at most [%]")
    violations = 0
    for n in sizes:
        problem = EXAMPLES["6.1"](n)
        for strategy in (formulations.fixed, formulations.joint):
            solution = strategy.solve(problem)
            found = certify(solution)
            records.append({**solution.record(), **found.record()})
            inside = found.lower <= EXACT_ENERGY_61 <= found.upper
            violations += not (inside and found.guaranteed_lower and found.guaranteed_upper)
            ratio = (found.upper - found.lower) / (found.upper - EXACT_ENERGY_61)
            name = strategy.__name__.split(".")[-1]
            print(
                f"{n:4d}  {name:8s} {found.lower:12.7f} {found.upper:12.7f} {ratio:10.2f}"
                f" {100 * found.relative:12.1f}{'' if inside else '  VIOLATED'}"
            )
    if figure is not None:
        with rc_context(SETTINGS):
            drawn = bracket_figure(records)
            drawn.axes[0].axhline(EXACT_ENERGY_61, color="0.5", linewidth=0.8)
            save(drawn, figure.with_suffix(""), ("png",))
    return violations


def objective_part() -> int:
    """Meshes of least certified bound beside meshes of least energy; returns the number of violations."""
    cases: list[tuple[str, ContactProblem, float | None]] = [
        ("6.1, n = 8", EXAMPLES["6.1"](8), EXACT_ENERGY_61),
        ("6.1, n = 16", EXAMPLES["6.1"](16), EXACT_ENERGY_61),
    ]
    for kind, seed in (("scalar", 1), ("scalar", 3), ("membrane", 1), ("membrane", 2)):
        cases.append((f"{kind}, seed {seed}", random_problem(seed, kind=kind), None))
    print(
        "\nproblem             mesh                    upper        lower  computed gap  true gap  residual"
    )
    violations = 0
    for name, problem, least in cases:
        if least is None:
            fine = bracket_of(replace(problem, mesh=problem.mesh.refined(4)))
            least = (fine.lower + fine.upper) / 2
        energy = formulations.nested.solve(problem)
        solutions = {
            "as given": formulations.fixed.solve(problem),
            "least energy": energy,
            "least bound": formulations.nested.solve(problem, objective="certificate"),
            "least bound from there": formulations.nested.solve(
                problem, objective="certificate", start=energy
            ),
        }
        for mesh, solution in solutions.items():
            found = bracket_of(replace(problem, mesh=solution.mesh), 0)  # the field as it is minimised
            violations += not found.lower <= least <= found.upper
            print(
                f"{name:19s} {mesh:22s} {found.upper:12.7f} {found.lower:12.7f}"
                f" {found.upper - found.lower:11.3e} {found.upper - least:11.3e}"
                f" {solution.stationarity_residual:7.0e}"
            )
    return violations


def cost_part() -> None:
    """Process time of a bracket over that of a contact solve with assembly."""
    print("\nproblem            nodes   contact solve [s]   bracket [s]   in contact solves")
    for name, n in (("6.1", 32), ("6.1", 64), ("6.1", 128), ("6.3", (48, 24)), ("6.3", (96, 48))):
        problem = EXAMPLES[name](n)
        model, nodes = ContactModel(problem), problem.mesh.p
        guess = contact_solution(model, nodes)
        solve = seconds(lambda m=model, x=nodes: m.solve(x))
        whole = seconds(lambda p=problem, x=nodes, g=guess: bracket(p, x, g))
        print(f"{name} {n!s:10s} {nodes.shape[1]:8d} {solve:15.3f} {whole:15.3f} {whole / solve:15.1f}")


def seconds(run: Callable[[], object], repeat: int = 3) -> float:
    """Median process time of some calls."""
    taken = []
    for _ in range(repeat):
        began = time.process_time()
        run()
        taken.append(time.process_time() - began)
    return statistics.median(taken)


def block(poisson: float, mesh: MeshTri) -> ContactProblem:
    """A block held on its left, pressed down on a rigid plane with friction."""
    return ContactProblem(
        mesh,
        PlaneStrain.from_young(100.0, poisson, (0.0, -2.0)),
        (Dirichlet("left", (0.0, 0.0)),),
        Obstacle("bottom", (0.0, 1.0), friction=0.2),
        tractions=(Traction("top", (0.0, -1.0)),),
    )


def degradation_part() -> None:
    """How the bounds degrade near incompressibility and on thin elements."""
    print("\nPoisson's ratio   error at most [%]   computed/true   residual")
    for poisson in (0.3, 0.45, 0.49, 0.499, 0.4999, 0.49999):
        degradation_row(f"{poisson:<12g}", block(poisson, rectangle(8, 4, x=(0, 2))))
    print("\naspect of elements  error at most [%]   computed/true   residual")
    for aspect in (1, 4, 16, 64, 256):
        degradation_row(f"1:{aspect:<10d}", block(0.3, rectangle(4, 2 * aspect, x=(0, 2))))


def degradation_row(name: str, problem: ContactProblem) -> None:
    """One line of these tables."""
    rough = bracket_of(problem)
    if problem.mesh.t.shape[1] > 1200:
        ratio = "-"
    else:
        found = compared(rough, bracket_of(replace(problem, mesh=problem.mesh.refined(FINER)))).ratio
        ratio = "-" if found is None else f"{found:.2f}"
    error = 100 * np.sqrt(2 * (rough.upper - rough.lower)) / rough.norm
    print(f"{name} {error:15.2f} {ratio:>17s} {rough.residual:15.0e}  {'; '.join(rough.why)}")


def peers_part() -> None:
    """Aitken's extrapolation of the energy from three grids, beside the bracket of the finest."""
    print("\nproblem   extrapolated     bracket of the finest of the three grids      inside")
    for name, sizes in (
        ("6.1", (8, 16, 32)),
        ("6.2", ((12, 6), (24, 12), (48, 18))),
        ("6.3", ((12, 6), (24, 12), (48, 24))),
    ):
        found = [bracket_of(EXAMPLES[name](n)) for n in sizes]
        a, b, c = (one.upper for one in found)
        guess = c - (c - b) ** 2 / ((c - b) - (b - a))
        inside = found[-1].lower <= guess <= found[-1].upper
        print(f"{name:9s} {guess:12.7f}   [{found[-1].lower:.7f}, {found[-1].upper:.7f}]   {inside}")


def large_part() -> None:
    """One elastic problem of 51,200 triangles."""
    problem = EXAMPLES["6.3"]((320, 80))
    model = ContactModel(problem)
    guess = contact_solution(model, problem.mesh.p)
    taken = seconds(lambda: bracket(problem, problem.mesh.p, guess), repeat=1)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"\n{problem.mesh.t.shape[1]} triangles: {taken:.1f} s, {memory:.2f} GB at most")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the parts asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parts = ("exact", "random", "objective", "cost", "degradation", "peers", "large")
    parser.add_argument("--parts", nargs="+", choices=parts, default=parts[:-1])
    parser.add_argument("--seeds", type=int, default=250, help="random problems of each of the four kinds")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--relocate-every", type=int, default=10)
    parser.add_argument("--keep", type=Path, help="JSON lines file that random problems are kept in")
    parser.add_argument("--n", type=int, nargs="+", default=[4, 8, 16, 32], help="grids of Example 6.1")
    parser.add_argument("--figure", type=Path, help="draw the brackets of Example 6.1 to this PNG file")
    options = parser.parse_args(arguments)
    seeds = range(options.first, options.first + options.seeds)
    violations = 0
    if "exact" in options.parts:
        violations += exact_part(options.n, options.figure)
    if "random" in options.parts:
        violations += random_part(options.kinds, seeds, options.relocate_every, options.keep)
    if "objective" in options.parts:
        violations += objective_part()
    if "cost" in options.parts:
        cost_part()
    if "degradation" in options.parts:
        degradation_part()
    if "peers" in options.parts:
        peers_part()
    if "large" in options.parts:
        large_part()
    print(f"\nviolations: {violations}")
    return int(violations > 0)


if __name__ == "__main__":
    sys.exit(main())
