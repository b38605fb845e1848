"""How a solution changes with parameters and bounds: the implicit function theorem on the active branch.

With ``z = (x, lam)`` and ``c = (x, g, G, H)`` a solution has

    gradient of the Lagrangian = 0,    c_i = b_i where i is active,    lam_i = 0 elsewhere.

Active are equations, rows and bounds with a multiplier, and of each pair the smaller member and those with a
multiplier. With these equations F and causes t, ``dz = -(dF/dz)^-1 dF/dt dt``. Where a pair is biactive or a
constraint active without a multiplier this is the derivative on one side only. Where dF/dz is singular there
is none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.mpcc.problem import MPCC

_NONE = 1e-8  # multipliers up to this are none
_LINEAR_SOLVER = "csparse"
_PARTS = ("x", "g", "G", "H")
Symbols = Mapping[str, Any]
_CAUSES = ("p", "lbx", "ubx", "lbg", "ubg")


def forward(mpcc: MPCC, inputs: Symbols, outputs: Symbols, seeds: Symbols) -> list[Any]:
    """Changes of the outputs, one column for each column of the changes ``seeds`` of the inputs.

    Symbols (MX) are named as the inputs and outputs of ``mpccsol``. Starts have no influence.
    """
    by_z, by_t, out_z, out_t = _linearised(mpcc, inputs, outputs)
    change = ca.vertcat(*(seeds[cause] for cause in _CAUSES))
    moved = ca.mtimes(out_z, ca.solve(by_z, -ca.mtimes(by_t, change), _LINEAR_SOLVER))
    return _split(moved + ca.mtimes(out_t, change), outputs.values())


def reverse(mpcc: MPCC, inputs: Symbols, outputs: Symbols, seeds: Symbols) -> list[Any]:
    """Derivatives by the inputs of the outputs weighted by each column of ``seeds``; see :func:`forward`."""
    by_z, by_t, out_z, out_t = _linearised(mpcc, inputs, outputs)
    weights = ca.vertcat(*(seeds[name] for name in outputs))
    adjoint = ca.solve(by_z.T, ca.mtimes(out_z.T, weights), _LINEAR_SOLVER)
    found = ca.mtimes(out_t.T, weights) - ca.mtimes(by_t.T, adjoint)
    of_causes = dict(zip(_CAUSES, _split(found, [inputs[cause] for cause in _CAUSES]), strict=True))
    return [of_causes.get(name, ca.MX(symbol.shape[0], weights.shape[1])) for name, symbol in inputs.items()]


def _split(column: Any, parts: Iterable[Any]) -> list[Any]:
    """Rows of a matrix, as many as each part has; dense."""
    ends = np.cumsum([0, *(part.shape[0] for part in parts)]).tolist()
    return list(ca.vertsplit(ca.densify(column), ends))


def _linearised(mpcc: MPCC, inputs: Symbols, outputs: Symbols) -> Any:
    """dF/dz, dF/dt, and the derivatives of the outputs by z and t, at symbols."""
    oracle = ca.Function("oracle", [mpcc.x, mpcc.p], [mpcc.f, mpcc.g, mpcc.G, mpcc.H])
    n = {part: int(getattr(mpcc, part).shape[0]) for part in (*_PARTS, "p")}
    z = {"x": ca.MX.sym("x", n["x"]), **{f"lam_{part}": ca.MX.sym(part, n[part]) for part in _PARTS}}
    t = {name: ca.MX.sym(name, n[name[-1]]) for name in _CAUSES}
    value = {"x": z["x"], **dict(zip(("f", "g", "G", "H"), oracle(z["x"], t["p"]), strict=True))}
    rows = ca.vertcat(*(value[part] for part in _PARTS))
    lam = ca.vertcat(*(z[f"lam_{part}"] for part in _PARTS))
    lagrangian = value["f"] + ca.dot(lam, rows)
    active, bound = _active(value, z, t)
    equations = ca.vertcat(ca.gradient(lagrangian, z["x"]), active * (rows - bound) + (1 - active) * lam)
    every = {**value, **z, "lam_p": -ca.gradient(lagrangian, t["p"])}
    column = ca.vertcat(*(every[name] for name in outputs))
    parts = [_jacobian(part, symbols) for part in (equations, column) for symbols in (z, t)]
    function = ca.Function("linearised", [*z.values(), *t.values()], parts)
    return function(*(outputs[name] for name in z), *(inputs[name] for name in t))


def _jacobian(column: Any, symbols: dict[str, Any]) -> Any:
    return ca.horzcat(*(ca.jacobian(column, symbol) for symbol in symbols.values()))


def _active(value: dict[str, Any], z: dict[str, Any], t: dict[str, Any]) -> tuple[Any, Any]:
    """Which rows of (x, g, G, H) are active (1 or 0), and the bound that each would be at."""
    is_held = {part: ca.fabs(z[f"lam_{part}"]) > _NONE for part in _PARTS}
    for part in ("x", "g"):
        is_held[part] = ca.logic_or(is_held[part], t[f"lb{part}"] == t[f"ub{part}"])
    smaller = value["G"] < value["H"]
    is_held["G"] = ca.logic_or(is_held["G"], smaller)
    is_held["H"] = ca.logic_or(is_held["H"], ca.logic_not(smaller))
    bounds = [ca.if_else(z[f"lam_{part}"] < 0, t[f"lb{part}"], t[f"ub{part}"]) for part in ("x", "g")]
    none = ca.MX.zeros(value["G"].shape[0] + value["H"].shape[0])
    return ca.vertcat(*is_held.values()), ca.vertcat(*bounds, none)
