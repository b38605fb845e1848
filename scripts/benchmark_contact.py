"""A contact solve against the sparse factorisations that it is made of.

    OPENBLAS_NUM_THREADS=1 python scripts/benchmark_contact.py --n 32 64 128 224

Example 6.1 on the given mesh, and Example 6.3 with as many squares along x_1. For each the milliseconds of
a cold contact solve, of assembling its system, and of one factorisation of the stiffness at the solution:
SciPy's ``splu`` as it comes, and with the ordering that we use. ``sets`` are the active sets that were
tried, each with its factorisation; the guess of the first one takes another. Medians of five.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Sequence

from scipy.sparse.linalg import splu

from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.contact.system import factorised
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem


def seconds(run: Callable[[], object], repeat: int = 5) -> float:
    """Median time of some calls."""
    taken = []
    for _ in range(repeat):
        began = time.perf_counter()
        run()
        taken.append(time.perf_counter() - began)
    return statistics.median(taken)


def row(name: str, n: int, problem: ContactProblem) -> str:
    """One line of the table."""
    model = ContactModel(problem)
    nodes = problem.mesh.p
    solution = model.solve(nodes)
    system = model.system(nodes)
    inside = system.rotated.free(solution.active).nonzero()[0]
    matrix = system.rotated.K[:, inside][inside]
    sets = solution.iterations
    whole, assembling = seconds(lambda: model.solve(nodes)), seconds(lambda: model.system(nodes))
    plain, ordered = seconds(lambda: splu(matrix)), seconds(lambda: factorised(matrix))
    times = "".join(f"{1e3 * each:10.2f}" for each in (whole, assembling, plain, ordered))
    ratios = "".join(f"{whole / (sets * each):8.2f}" for each in (plain, ordered))
    return f"{name} {n:5d} {inside.size:9d} {sets:5d}{times}{ratios}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line per grid."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--n", type=int, nargs="+", default=[32, 64, 128, 224], help="squares along x_1")
    options = parser.parse_args(arguments)
    print("                             milliseconds of                       solve per set over")
    print("         n  unknowns  sets     solve  assembly      splu      ours    splu    ours")
    for n in options.n:
        print(row("6.1", n, EXAMPLES["6.1"](n)), flush=True)
        print(row("6.3", n, EXAMPLES["6.3"]((n, n // 2))), flush=True)


if __name__ == "__main__":
    main()
