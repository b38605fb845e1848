"""Problems as NOSBENCH stores them: JSON with serialised CasADi Functions.

Fields: ``w0, lbw, ubw``, ``p0``, ``g_fun, lbg, ubg``, ``G_fun, H_fun``, ``augmented_objective_fun`` (or
``objective_fun``); each Function takes ``(w, p)``. https://github.com/nosnoc/nosbench
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.reading.problem import Problem

_OBJECTIVES = ("augmented_objective_fun", "objective_fun")


def read_nosbench(path: Path) -> Problem:
    """Read one problem; raises ValueError naming the file and the field that is missing or malformed."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{path}: not a JSON file: {error}") from error
    if not isinstance(data, dict):
        raise ValueError(f"{path}: must hold a JSON object")
    objective = next((name for name in _OBJECTIVES if name in data), _OBJECTIVES[0])
    names = {"f": objective, "g": "g_fun", "G": "G_fun", "H": "H_fun"}
    functions = {key: _function(path, data, name) for key, name in names.items()}
    x0 = _numbers(path, data, "w0", None)
    p0 = _numbers(path, data, "p0", np.zeros(0))
    expanded = all(function.is_a("SXFunction") for function in functions.values())
    kind = ca.SX if expanded else ca.MX
    w, p = kind.sym("w", x0.size), kind.sym("p", p0.size)
    columns: dict[str, Any] = {}
    for key, function in functions.items():
        try:
            columns[key] = function.call([w, p][: function.n_in()])[0]
        except RuntimeError as error:
            raise ValueError(f"{path}: {names[key]} does not take w of length {x0.size}: {error}") from error
    bounds: dict[str, Any] = {
        ours: _numbers(path, data, theirs, default)
        for ours, theirs, default in (
            ("lbx", "lbw", np.array(-np.inf)), ("ubx", "ubw", np.array(np.inf)),
            ("lbg", "lbg", np.array(0.0)), ("ubg", "ubg", np.array(0.0)),
        )
    }  # fmt: skip
    mpcc = MPCC(x=w, p=p, **columns, **bounds)
    return Problem(path.stem, mpcc, x0, p0)


def _function(path: Path, data: dict[str, Any], name: str) -> ca.Function:
    text = data.get(name)
    if not isinstance(text, str):
        raise ValueError(f"{path}: the field {name} is missing or no serialised Function")
    try:
        return ca.Function.deserialize(text)
    except RuntimeError as error:
        raise ValueError(f"{path}: the field {name} is no serialised Function: {error}") from error


def _numbers(path: Path, data: dict[str, Any], name: str, default: Array | None) -> Array:
    """A list of numbers; JSON has no infinity, so null, "inf" and numbers from 1e20 on stand for it."""
    if name not in data or data[name] is None:
        if default is None:
            raise ValueError(f"{path}: the field {name} is missing")
        return default
    raw = data[name] if isinstance(data[name], list) else [data[name]]
    sign = -1.0 if name.startswith("lb") else 1.0
    try:
        values = np.array([sign * np.inf if v is None else float(v) for v in _flat(raw)])
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: the field {name} must be a list of numbers: {error}") from error
    if values.size == 0 and default is not None:
        return default
    if name.startswith(("lb", "ub")):
        values[np.abs(values) >= 1e20] *= np.inf
    return values


def _flat(values: list[Any]) -> list[Any]:
    return [part for value in values for part in (_flat(value) if isinstance(value, list) else [value])]


def write_nosbench(problem: Problem, path: Path) -> None:
    """Write a problem in the same form."""
    mpcc = problem.mpcc
    arguments = [mpcc.x, mpcc.p]
    parts = {"g_fun": mpcc.g, "G_fun": mpcc.G, "H_fun": mpcc.H, "augmented_objective_fun": mpcc.f}
    data: dict[str, Any] = {
        name: ca.Function(name, arguments, [part], ["w", "p"], [name[:-4]]).serialize()
        for name, part in parts.items()
    }
    data["w0"] = mpcc.start(problem.x0, problem.p0).tolist()
    data["p0"] = problem.p0.tolist()
    for ours, theirs in (("lbx", "lbw"), ("ubx", "ubw"), ("lbg", "lbg"), ("ubg", "ubg")):
        values = np.asarray(getattr(mpcc, ours))
        data[theirs] = [float(v) if np.isfinite(v) else None for v in values]
    path.write_text(json.dumps(data), encoding="utf-8")
