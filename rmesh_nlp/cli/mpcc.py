"""``rmesh mpcc``, which is also ``rmesh-mpcc``: MPCCs from files, or as AMPL calls solvers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rmesh_nlp.cli import Exit
from rmesh_nlp.errors import BadInputError, one_line
from rmesh_nlp.mpcc import ampl
from rmesh_nlp.mpcc.options import Options
from rmesh_nlp.mpcc.reading import read
from rmesh_nlp.mpcc.result import Duals
from rmesh_nlp.mpcc.solver import solve

_DUALS = ("lam_x", "lam_g", "lam_G", "lam_H")


def run(words: Sequence[str], chosen: Mapping[str, Any], log: bool, as_json: bool, start: Path | None) -> int:
    """Solve files and print what was found, or answer AMPL (:func:`rmesh_nlp.mpcc.ampl.run`).

    ``chosen`` has fields of :class:`rmesh_nlp.mpcc.Options`; ``start`` is the JSON of a former solve.
    """
    try:
        if ampl.is_meant(words):
            return ampl.run(words)
        if unknown := [word for word in words if word.startswith("-")]:
            raise BadInputError(f"no such option: {unknown[0]}")
        if not words:
            raise BadInputError("no file given; see rmesh mpcc --help")
        options = Options().having(chosen)
        former = None if start is None else _former(start)
        return max([_solved(Path(word), options, log, as_json, former) for word in words])
    except ValueError as error:
        raise BadInputError(one_line(error)) from error


def _number(value: float) -> float | None:
    """JSON has no NaN, which multipliers are where there are none."""
    return float(value) if math.isfinite(value) else None


def _former(path: Path) -> tuple[Any, Duals]:
    """Unknowns and multipliers of a former solve."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return data["x"], Duals(*(np.array(data[name], dtype=float) for name in _DUALS))
    except (KeyError, TypeError, ValueError) as error:
        raise BadInputError(f"{path} is not what rmesh mpcc --json prints for one file: {error}") from error


def _solved(path: Path, options: Options, log: bool, as_json: bool, former: tuple[Any, Duals] | None) -> int:
    """Solve one file and print status, label, residuals."""
    problem = read(path)
    x0, start = (problem.x0, problem.start) if former is None else former
    result = solve(problem.mpcc, x0, p=problem.p0, start=start, options=options, progress=log)
    mpcc, f, seconds = problem.mpcc, problem.sign * result.f, result.seconds["total"]
    reached = [replace(end, f=problem.sign * end.f) for end in result.reached]
    iterations, solves = result.counts["ipopt_iterations"], result.counts["nlp_solves"]
    violation, complementarity = result.constraint_violation, result.complementarity
    if as_json:
        words = {
            "problem": problem.name, "status": result.status.value, "success": result.success, "f": f,
            "constraint_violation": violation, "complementarity": complementarity,
            "stationarity": result.stationarity, "n_biactive": result.n_biactive,
            "b_stationary": result.b_stationary, "iterations": iterations, "seconds": seconds,
            "starts": [
                {"f": None if math.isnan(end.f) else end.f, "status": end.status.value, "number": end.starts}
                for end in reached
            ],
            "x": result.x[: mpcc.n_own].tolist(),
            **{name: [_number(value) for value in getattr(result, name)] for name in _DUALS},
        }  # fmt: skip
        print(json.dumps(words))
    else:
        print(f"{problem.name}: {mpcc.n_own} unknowns, {mpcc.n_g} rows, {mpcc.n_pairs} pairs")
        print(f"  status           {result.status.value}: {result.message}")
        print(f"  objective        {f:.12g}")
        print(f"  stationarity     {result.label}")
        print(f"  residuals        violation {violation:.1e}, min(G, H) {complementarity:.1e}")
        if reached:
            print(f"  starts           {'; '.join(map(str, reached))}")
        print(f"  cost             {iterations} iterations in {solves} steps, {seconds:.2f} s")
    return Exit.SUCCESS if result.success else Exit.NO_SUCCESS
