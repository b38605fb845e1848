"""A bilevel program as an MPCC: the KKT conditions of the lower level as constraints and pairs.

    min over (x, y) of F(x, y)   subject to   upper bounds and rows,   y in argmin of the lower level

becomes, with one multiplier ``m >= 0`` for each finite bound of the lower level's y and g,

    gradient_y f + lam_x + (gradient_y g)^T lam_g = 0,      0 <= m  _|_  (distance from its bound) >= 0,

where ``lam_x`` and ``lam_g`` have CasADi's signs: the multiplier of the upper bound minus that of the lower
one. An equality has one multiplier of any sign. Sources: Bard, *Practical Bilevel Optimization* (1998);
Dempe, *Foundations of Bilevel Programming* (2002).
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from rmesh_nlp.errors import expect, located, unknown
from rmesh_nlp.mpcc.lower_level import LowerLevel
from rmesh_nlp.mpcc.problem import MPCC, _column
from rmesh_nlp.optimize.nlp import NLP, Symbolic
from rmesh_nlp.settings import ByName

_KEYS = ("x", "f", "g", "p", "lbx", "ubx", "lbg", "ubg")


def bilevel(upper: ByName, lower: ByName, *, variables: Symbolic) -> MPCC:
    """Write the KKT conditions of a lower-level NLP as constraints and complementarity pairs.

    Parameters
    ----------
    upper : mapping
        ``x``, the upper level's variables, and ``f``, minimised over them and over ``variables``; perhaps
        ``g``, parameters ``p`` of both levels, and the bounds ``lbx``, ``ubx``, ``lbg``, ``ubg``, with the
        meaning of ``nlpsol``. ``f`` and ``g`` may depend on ``variables``.
    lower : mapping
        ``f``, minimised over ``variables``, perhaps ``g``, and bounds: ``lbx`` and ``ubx`` are those of
        ``variables``. To maximise, change the sign. ``f`` and ``g`` must be twice differentiable.
    variables : SX or MX, or a list of symbols
        The lower level's variables.

    Returns
    -------
    MPCC
        Its unknowns are x, ``variables`` and the multipliers. ``parts`` has ``upper``, ``lower``, and
        ``lam_x`` and ``lam_g`` of the lower level in CasADi's signs, for :meth:`MPCC.extended`. A start may
        be given for x alone: ``lower_level.start`` then solves the lower level for the rest. Results say in
        ``lower_level`` whether the lower level ended at a minimum.

    Raises
    ------
    ValueError
        As :class:`MPCC`, with the level in the message; or if a key is unknown or missing.

    Notes
    -----
    KKT conditions are necessary for a minimum of the lower level only under a constraint qualification, and
    sufficient only if it is convex. Where the lower level has several minima the MPCC takes that which
    suits the upper level (optimistic).
    """
    expect("upper", upper, Mapping)
    expect("lower", lower, Mapping)
    if "x" not in upper:
        raise ValueError("upper: 'x' is missing, the upper level's variables")
    if "p" in lower:
        raise ValueError("lower: parameters p belong to the upper level's mapping, for both levels")
    x = _column("x", upper["x"], None)
    kind = type(x)
    y, p = _column("variables", variables, kind), _column("p", upper.get("p"), kind)
    if "x" in lower and not ca.is_equal(_column("x", lower["x"], None), y, 1):
        raise ValueError("lower: x is not the column of the variables; it may be left out")
    if ca.depends_on(x, y):
        raise ValueError(f"upper: x has variables of the lower level, {y}; it is the upper level's alone")
    above = _level("upper", upper, [y, p])
    below = _level("lower", {**lower, "x": y}, [x, p])
    # in pure symbols, so that CasADi can derive it
    pure_y, pure_p = kind.sym("y", below.n_x), kind.sym("p", below.p.shape[0])
    f, g, *_ = below.oracle.call([pure_y, pure_p], True, False)
    level = LowerLevel(NLP(pure_y, pure_p, f, g, below.lbx, below.ubx, below.lbg, below.ubg), above.n_x)
    sides, n_sides, n_y = level.sides, level.sides.entry.size, below.n_x
    shape, n_pairs = (n_y + below.n_g, n_sides), int(np.sum(~sides.equal))
    signs = ca.DM.triplet(sides.entry.tolist(), list(range(n_sides)), ca.DM(sides.sign), *shape)
    multiplier = kind.sym("multiplier", n_sides)
    lam_x, lam_g, _ = ca.vertsplit(ca.densify(signs @ multiplier), [0, n_y, shape[0], shape[0]])
    lagrangian = {"gamma": ["f", "g"]}
    gradient = below.oracle.factory("slope", ["x", "p", "lam:f", "lam:g"], ["grad:gamma:x"], lagrangian)
    (slope,) = gradient.call([below.x, below.p, kind(1), lam_g], True, False)
    room = ca.DM(sides.sign * sides.bound) - signs.T @ ca.vertcat(below.x, below.g)
    member, _ = ca.vertsplit(multiplier, [0, n_pairs, n_sides])
    distance, equations = ca.vertsplit(room, [0, n_pairs, n_sides])
    zero, free = np.zeros(n_y + n_sides - n_pairs), np.full(n_y + n_sides, np.inf)
    return MPCC(
        [above.x, below.x, multiplier], above.f,
        [above.g, slope + lam_x, equations], member, distance,
        lbx=np.append(above.lbx, -free), ubx=np.append(above.ubx, free),
        lbg=np.append(above.lbg, zero), ubg=np.append(above.ubg, zero), p=p,
        completions={above.n_x: lambda x, values: level.start(x, p=values, multipliers=1.0)[x.size :]},
        parts={"upper": above.x, "lower": below.x, "lam_x": lam_x, "lam_g": lam_g}, lower_level=level,
    )  # fmt: skip


def _level(name: str, level: ByName, p: list[Symbolic]) -> MPCC:
    """One level, checked, as a program without pairs; its parameters are all that it does not choose."""
    with located(name):
        for key in level:
            if key not in _KEYS:
                raise unknown("key", key, _KEYS)
        if "f" not in level:
            raise ValueError("'f' is missing, the objective")
        if level.get("g") is not None and not {"lbg", "ubg"} & set(level):
            raise ValueError("g has neither lbg nor ubg, so it constrains nothing")
        return MPCC(**{**level, "p": p})
