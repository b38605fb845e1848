"""Problems from public formats: AMPL ``.nl``, NOSBENCH's JSON, Pyomo models.

NOSBENCH stores serialised CasADi Functions of ``(w, p)``: ``g_fun, G_fun, H_fun``,
``augmented_objective_fun`` (or ``objective_fun``), and numbers ``w0, lbw, ubw, p0, lbg, ubg``.
https://github.com/nosnoc/nosbench
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array, kind_of
from rmesh_nlp.mpcc.names import named
from rmesh_nlp.mpcc.nl import Rows, read_rows
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import Duals
from rmesh_nlp.settings import Values

_OBJECTIVES = ("augmented_objective_fun", "objective_fun")
_BOUNDS = {"lbx": ("lbw", -np.inf), "ubx": ("ubw", np.inf), "lbg": ("lbg", 0.0), "ubg": ("ubg", 0.0)}
"""Our bounds by NOSBENCH's names and defaults."""


@dataclass(frozen=True, eq=False)
class Problem:
    """What :func:`rmesh_nlp.mpcc.read` returns.

    Attributes
    ----------
    name : str
    mpcc : MPCC
    x0 : array
        Start, of the file's own unknowns; ``mpcc.start`` completes it.
    p0 : array
        Values of the parameters.
    sign : float
        -1 if the file maximises: ``mpcc.f`` is then minus its objective.
    target : float
        The best known value, where there is one; else NaN.
    start : Duals, optional
        Multipliers of a former solve, of a ``.nl`` file that has some.
    rows : Rows, optional
        The ``.nl`` file as read, see :func:`rmesh_nlp.mpcc.sol.write_sol`.
    """

    name: str
    mpcc: MPCC
    x0: Array
    p0: Array = field(default_factory=lambda: np.zeros(0))
    sign: float = 1.0
    target: float = float("nan")
    start: Duals | None = None
    rows: Rows | None = None


def read(source: str | PathLike[str] | Any) -> Problem:
    """Read an MPCC from a file, or from a Pyomo model.

    Parameters
    ----------
    source : path or pyomo.environ.ConcreteModel
        ``.nl``: AMPL's format, text or binary, with complementarity rows. ``.json``: CasADi Functions as
        NOSBENCH serialises them.

    Raises
    ------
    ValueError
        If the format is unknown or the file malformed; the message names the file, and the line or field.
    OSError
        If the file cannot be read.
    """
    if not isinstance(source, (str, PathLike)):
        if hasattr(source, "component_data_objects"):
            return read_pyomo(source)
        raise ValueError(f"expected a path or a Pyomo model, got {type(source).__name__}")
    path = Path(source)
    if path.suffix.lower() not in READERS:
        raise ValueError(f"{path}: unknown format {path.suffix!r}; there are {', '.join(READERS)}")
    return READERS[path.suffix.lower()](path)


def read_nl(path: Path) -> Problem:
    """Read an AMPL ``.nl`` file as an MPCC; a maximised objective changes its sign."""
    rows = read_rows(path)
    try:
        return Problem(path.stem, mpcc_of(rows), rows.x0, sign=rows.sign, start=_start(rows), rows=rows)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def mpcc_of(rows: Rows, p: ca.SX | None = None) -> MPCC:
    """The rows of a ``.nl`` file as an MPCC; ``p`` are symbols in them that are not unknowns.

    Raises
    ------
    ValueError
        If a row complements a bound that its unknown does not have, or bounds leave no value.
    """
    at = list(rows.complements)
    bits, j = np.array(list(rows.complements.values()), dtype=int).reshape(-1, 2).T
    lower, upper = np.where(bits & 1, rows.lbx[j], -np.inf), np.where(bits & 2, rows.ubx[j], np.inf)
    is_lower, is_upper = np.isfinite(lower), np.isfinite(upper)
    for k in np.flatnonzero((bits != 0) & ~is_lower & ~is_upper):  # of two bounds one may be infinite
        row, unknown = f"row {at[k]} ({rows.row_names[at[k]]})", named(rows.x, int(j[k]))
        raise ValueError(f"{row} complements an infinite bound of {unknown}")
    kept = [i for i in range(len(rows.bodies)) if i not in rows.complements]
    return MPCC.mixed(
        rows.x, rows.sign * rows.f, [rows.bodies[i] for i in kept],
        G=[rows.bodies[i] for i in at], lbG=np.where(is_lower & ~is_upper, 0.0, -np.inf),
        ubG=np.where(is_upper & ~is_lower, 0.0, np.inf), H=rows.x[j.tolist()], lbH=lower, ubH=upper,
        lbx=rows.lbx, ubx=rows.ubx, lbg=rows.lower[kept], ubg=rows.upper[kept], p=p,
    )  # fmt: skip


def rows_of(rows: Rows) -> tuple[MPCC, Array]:
    """The MPCC with symbols p for the rows of a file, and how (g, G, H) depend on (p, x): they are linear."""
    m = len(rows.bodies)
    bodies = ca.SX.sym("row", m)
    linear = mpcc_of(replace(rows, bodies=ca.vertsplit(bodies) if m else [], f=ca.SX(0)), bodies)
    columns, both = ca.vertcat(linear.g, linear.G, linear.H), ca.vertcat(linear.p, linear.x)
    jacobian = ca.Function("jacobian", [linear.x, linear.p], [ca.jacobian(columns, both)])
    return linear, np.asarray(jacobian(0, 0).full())


def _start(rows: Rows) -> Duals | None:
    """The duals of a file as multipliers: that of a bound in a pair counts as the bound's, which adds up."""
    if not (np.any(rows.duals) or np.any(rows.reduced)):
        return None
    linear, jacobian = rows_of(rows)
    column = -rows.sign * jacobian[:, : rows.duals.size] @ rows.duals
    lam_x = np.append(-rows.sign * rows.reduced, np.zeros(linear.n_x - rows.reduced.size))
    return Duals(lam_x, *np.split(column, [linear.n_g, linear.n_g + linear.n_pairs]))


def read_pyomo(model: Any) -> Problem:
    """Read a concrete Pyomo model with ``pyomo.mpec`` conditions; it is not changed.

    Raises
    ------
    ImportError
        If Pyomo is not installed.
    ValueError
        If a condition is no pair of expressions, or the model has integer variables.
    """
    from rmesh_nlp.mpcc.pyomo_model import conditions_as_rows

    copy = model.clone()
    with tempfile.TemporaryDirectory() as folder, conditions_as_rows(copy) as written:
        path = Path(folder) / f"{model.name}.nl"
        copy.write(str(path), format="nl", io_options={"symbolic_solver_labels": True, **written})
        return replace(read_nl(path), rows=None)


def read_nosbench(path: Path) -> Problem:
    """Read one problem; raises ValueError naming the file and the field that is missing or malformed."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not a JSON file: {error}") from error
    if not isinstance(data, dict):
        raise ValueError(f"{path}: must hold a JSON object")
    objective = next((name for name in _OBJECTIVES if name in data), _OBJECTIVES[0])
    names = {"f": objective, "g": "g_fun", "G": "G_fun", "H": "H_fun"}
    functions = {key: _function(path, data, name) for key, name in names.items()}
    x0, p0 = (np.ravel(_numbers(path, data, name, default)) for name, default in (("w0", None), ("p0", ())))
    kind = kind_of(*functions.values())
    w, p = kind.sym("w", x0.size), kind.sym("p", p0.size)
    columns: Values = {}
    for key, function in functions.items():
        try:
            columns[key] = function.call([w, p][: function.n_in()])[0]
        except RuntimeError as error:
            raise ValueError(f"{path}: {names[key]} does not take w of length {x0.size}: {error}") from error
    for ours, (theirs, default) in _BOUNDS.items():
        columns[ours] = _numbers(path, data, theirs, default)
    return Problem(path.stem, MPCC(x=w, p=p, **columns), x0, p0)


def _function(path: Path, data: Values, name: str) -> ca.Function:
    text = data.get(name)
    if not isinstance(text, str) or not text:  # of an empty text CasADi makes no Function
        raise ValueError(f"{path}: the field {name} is missing or no serialised Function")
    try:
        return ca.Function.deserialize(text)
    except RuntimeError as error:
        raise ValueError(f"{path}: the field {name} is no serialised Function: {error}") from error


def _numbers(path: Path, data: Values, name: str, default: ArrayLike | None) -> Array:
    """Numbers; JSON has no infinity, so null, "inf" and numbers from 1e20 on stand for that of a bound."""
    given = data.get(name)
    given = default if given in (None, []) else given
    if given is None:
        raise ValueError(f"{path}: the field {name} is missing")
    try:
        values = np.array(given, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: the field {name} must be a list of numbers: {error}") from error
    if name in ("lbw", "lbg", "ubw", "ubg"):
        values[np.isnan(values)] = -np.inf if name.startswith("l") else np.inf
        values[np.abs(values) >= 1e20] *= np.inf
    return values


READERS = {".nl": read_nl, ".json": read_nosbench}
