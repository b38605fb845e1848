"""The least energies that are known on the paper's examples and their refinements: computed, not remembered.

    python scripts/best_known.py 6.1:8 6.1:16 6.2:12 6.3:12 --starts 8

Each grid is solved by ``joint``, by ``nested`` with newton-pair and by ``mpcc``, from the mesh as given and
from so many random starts. The least energy by the example's own rule is kept in docs/best_known.json with
the strategy and the seed that gave it; what is there already stays if it is lower, and was solved with these
boxes. Other scripts read that file: ``scripts/benchmark_scaling.py`` measures gains against it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from support.formulations import joint, mpcc, nested
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.solution import Solution

FILE = Path(__file__).parents[1] / "docs" / "best_known.json"

DELTA_61 = 0.22
"""The paper's box on 6.1 in units of a square's side: 0.0275 with 8 squares."""

PAPER_COLUMNS = 12
"""Columns of the paper's grids of 6.2 and 6.3."""


def problem(example: str, n: int) -> ContactProblem:
    """An example refined to ``n`` squares along x, its boxes shrunk with the squares."""
    if example == "6.1":
        return EXAMPLES["6.1"](n, DELTA_61 / n)
    paper = EXAMPLES[example]().motion.delta
    assert isinstance(paper, tuple)
    share = PAPER_COLUMNS / n
    return EXAMPLES[example]((n, n // 2), (paper[0] * share, paper[1] * share))


def lowest(example: str, n: int, starts: int, time_limit_s: float) -> dict[str, Any]:
    """The least energy of all strategies and starts, with where it came from."""
    found: list[tuple[float, str, int | None]] = []
    stated = problem(example, n)
    for seed in (None, *range(1, starts + 1)):
        solutions: list[Solution] = [
            joint.solve(stated, seed=seed, time_limit_s=time_limit_s),
            nested.solve(stated, seed=seed, outer="newton-pair", time_limit_s=time_limit_s),
            mpcc.solve(stated, seed=seed, time_limit_s=time_limit_s),
        ]
        found += [(one.energy, one.formulation, seed) for one in solutions if one.valid]
    if not found:
        raise SystemExit(f"{example} with {n} squares: no solve ended in a valid solution")
    energy, strategy, seed = min(found, key=lambda one: one[0])
    delta = stated.motion.delta_record()
    return {"example": example, "n": n, "delta": delta, "energy": energy, "by": strategy, "seed": seed}


def merged(known: Sequence[dict[str, Any]], new: dict[str, Any]) -> list[dict[str, Any]]:
    """The rows with the lower one of each grid and box."""

    def key(row: dict[str, Any]) -> tuple[Any, ...]:
        return row["example"], row["n"], tuple(row["delta"])

    rows = {key(row): row for row in known}
    if key(new) not in rows or new["energy"] < rows[key(new)]["energy"]:
        rows[key(new)] = new
    return [rows[place] for place in sorted(rows)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve the grids and write the file after each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("grids", nargs="+", metavar="EXAMPLE:N", help="such as 6.1:8 or 6.3:24")
    parser.add_argument("--starts", type=int, default=8, help="random starts besides the given mesh")
    parser.add_argument("--time-limit", type=float, default=60.0, help="seconds of each solve")
    parser.add_argument("--file", type=Path, default=FILE)
    options = parser.parse_args(arguments)
    for grid in options.grids:
        example, _, n = grid.partition(":")
        row = lowest(example, int(n), options.starts, options.time_limit)
        known = json.loads(options.file.read_text()) if options.file.exists() else []
        options.file.write_text(json.dumps(merged(known, row), indent=1) + "\n")
        print(f"{grid}: {row['energy']:.9g} by {row['by']}, seed {row['seed']}")


if __name__ == "__main__":
    main()
