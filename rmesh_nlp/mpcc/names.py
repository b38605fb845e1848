"""Names of unknowns and short texts of expressions, for messages."""

from __future__ import annotations

import casadi as ca

from rmesh_nlp.optimize.nlp import Symbolic

_SHORT, FEW = 12, 4  # nodes of an expression that is shown, symbols that are named


def symbol_names(x: Symbolic) -> list[str]:
    """The name of each entry of a column of SX or MX symbols, ``v[2]`` of a longer symbol ``v``."""
    if isinstance(x, ca.SX):
        return [str(x[i]) for i in range(x.shape[0])]
    names: list[str] = []
    for part in x.primitives():
        n = part.numel()
        names += [part.name()] if n == 1 else [f"{part.name()}[{k}]" for k in range(n)]
    return names


def named(symbols: Symbolic | None, i: int, column: str = "x") -> str:
    """Entry i of a column: ``x[3]``, or ``x[3] (pressure)`` where its symbol has a name of its own."""
    places = [f"{letter}{place}" for letter in "xp" for place in (f"_{i}", f"[{i}]")]
    name = places[0] if symbols is None else symbol_names(symbols)[i]
    return f"{column}[{i}]" + ("" if name in places else f" ({name})")


def in_short(expression: Symbolic) -> str:
    """An expression as text if that is short, else the first of the symbols that it depends on."""
    if ca.n_nodes(expression) <= _SHORT:
        return str(expression)
    symbols = [symbol.name() for symbol in ca.symvar(expression)]
    return f"a function of {', '.join(symbols[:FEW])}{', ...' if len(symbols) > FEW else ''}"
