"""The mathematical program with complementarity constraints (MPCC), checked when it is made.

Form and signs::

    minimise f(x, p)   subject to   lbg <= g(x, p) <= ubg,   lbx <= x <= ubx,
                                    0 <= G(x, p)  _|_  H(x, p) >= 0   componentwise,

that is ``G_i >= 0``, ``H_i >= 0`` and ``G_i H_i = 0`` for every pair i.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.lower_level import LowerLevel
from rmesh_nlp.mpcc.mixed import plain_pairs
from rmesh_nlp.mpcc.names import named
from rmesh_nlp.optimize.nlp import NLP, Derivatives, Symbolic, longer


@dataclass(frozen=True, eq=False)
class MPCC:
    """A parametric MPCC in CasADi expressions.

    Attributes
    ----------
    x : SX or MX, or a list of symbols
        Unknowns; stored as one column of symbols.
    f : scalar expression
        Objective, minimised.
    g : column or list of expressions, or None
        Ordinary constraints.
    G, H : columns or lists of expressions of one length
        The complementarity pairs. Their signs need not be repeated in ``g`` or ``lbx``.
    lbx, ubx, lbg, ubg : array_like
        Bounds; a scalar holds for every component, an omitted bound is infinite.
    p : SX or MX, optional
        Parameters, given values at each solve.
    derivatives : Derivatives, optional
        Assembled derivatives of the oracle with objective ``f`` and constraint column
        ``vertcat(g, G, H)``. None: CasADi derives them.
    completions : mapping of int to callable
        Where :meth:`mixed` or :func:`rmesh_nlp.mpcc.bilevel` have added unknowns after the user's: a start
        may be given for the first n alone, and ``completions[n](start, p)`` are starts of the next ones.
    parts : mapping of str to expression, optional
        Parts of the unknowns by name.
    switches : pair of columns, optional
        ``(r, d)`` with ``r_i d_i = 0``, of any signs. Each becomes ``r = r+ - r-``, ``d = d+ - d-`` with
        four unknowns after the user's, any two of which are a pair. None once they are split.
    lower_level : LowerLevel, optional
        The lower level whose KKT conditions these are, see :func:`rmesh_nlp.mpcc.bilevel`.

    Raises
    ------
    ValueError
        If x is not symbolic, f is not scalar, an expression has free symbols, G and H differ in
        length, or a bound has the wrong length, is NaN, or lies above its partner.
    """

    x: Symbolic
    f: Symbolic
    g: Symbolic = None
    G: Symbolic = None
    H: Symbolic = None
    lbx: Any = -np.inf
    ubx: Any = np.inf
    lbg: Any = -np.inf
    ubg: Any = np.inf
    p: Symbolic = None
    derivatives: Derivatives | None = None
    completions: Mapping[int, Callable[[Array, Array], Any]] = field(default_factory=dict, repr=False)
    parts: Mapping[str, Symbolic] = field(default_factory=dict, repr=False)
    lower_level: LowerLevel | None = None
    switches: tuple[Symbolic, Symbolic] | None = None

    def __repr__(self) -> str:
        p = f", {self.p.shape[0]} parameters" if self.p.shape[0] else ""
        return (
            f"MPCC({self.n_x} unknowns, {self.n_g} constraints, {self.n_pairs} complementarity pairs{p}; "
            f"{type(self.x).__name__} expressions x, f, g, G, H)"
        )

    def __post_init__(self) -> None:
        if self.switches is not None:
            split = _split(replace(self, switches=None), self.switches)
            for own in fields(self):
                object.__setattr__(self, own.name, getattr(split, own.name))
            return
        x = _column("x", self.x, None)
        kind = type(x)
        if kind not in (ca.SX, ca.MX) or not x.is_valid_input():
            raise ValueError(f"x must be a column of CasADi SX or MX symbols, got {self.x!r}"[:300])
        names = ("f", "g", "G", "H", "p")
        columns = {"x": x, **{name: _column(name, getattr(self, name), kind) for name in names}}
        if columns["f"].shape != (1, 1):
            raise ValueError(f"f must be a scalar expression, its shape is {columns['f'].shape}")
        if not columns["p"].is_valid_input():
            raise ValueError("p must be a column of symbols")
        n_G, n_H = columns["G"].shape[0], columns["H"].shape[0]
        if n_G != n_H:
            raise ValueError(f"G has length {n_G} and H has length {n_H}: they must pair up")
        x_bounds = _bounds("x", self.lbx, self.ubx, x.shape[0], x)
        g_bounds = _bounds("g", self.lbg, self.ubg, columns["g"].shape[0])
        bounds = zip(("lbx", "ubx", "lbg", "ubg"), x_bounds + g_bounds, strict=True)
        for name, value in (*columns.items(), *bounds):
            object.__setattr__(self, name, value)
        try:
            free = self.oracle.get_free() if self.oracle.has_free() else []
        except RuntimeError as error:  # the same symbol twice
            raise ValueError("x and p must be distinct symbols, each once") from error
        if free:
            raise ValueError(f"free symbols {free}: they are neither in x nor in p")
        if self.derivatives is not None:
            needed, got = (self.n_g + 2 * self.n_pairs, self.n_x), self.derivatives.jac_g.size_out(1)
            if tuple(got) != needed:
                raise ValueError(
                    f"derivatives.jac_g gives a Jacobian of shape {got}, vertcat(g, G, H) needs {needed}"
                )

    @cached_property
    def oracle(self) -> ca.Function:
        """``(x, p) -> (f, g, G, H)``."""
        symbols, columns = [self.x, self.p], [self.f, self.g, self.G, self.H]
        names = ["x", "p"], ["f", "g", "G", "H"]
        return ca.Function("oracle", symbols, columns, *names, {"allow_free": True})

    @cached_property
    def n_x(self) -> int:
        """Number of unknowns."""
        return self.x.shape[0]

    @cached_property
    def n_g(self) -> int:
        """Number of ordinary constraints."""
        return self.g.shape[0]

    @cached_property
    def n_pairs(self) -> int:
        """Number of complementarity pairs."""
        return self.G.shape[0]

    @property
    def n_own(self) -> int:
        """Number of the unknowns that a start must have; those after them can be completed."""
        return min(self.completions, default=self.n_x)

    def start(self, x0: ArrayLike, p: ArrayLike = ()) -> Array:
        """Return ``x0`` as a checked array; a scalar fills it, unknowns after the user's are completed."""
        given = _numbers("x0", x0).size
        n = given if given in (*self.completions, self.n_x) else self.n_own
        start = _values("x0", x0, n, finite=True, symbols=self.x)
        while start.size < self.n_x:
            rest = np.array(self.completions[start.size](start, self.parameters(p))).ravel()
            start = np.append(start, np.nan_to_num(rest))
        return start

    def parameters(self, p: ArrayLike) -> Array:
        """Return the values of ``p`` as a checked array."""
        return _values("p", p, self.p.shape[0], finite=True, symbols=self.p)

    def extended(
        self,
        *,
        x: Symbolic | None = None,
        p: Symbolic | None = None,
        f: Symbolic = 0,
        g: Symbolic | None = None,
        G: Symbolic | None = None,
        H: Symbolic | None = None,
        lbx: ArrayLike = -np.inf,
        ubx: ArrayLike = np.inf,
        lbg: ArrayLike = -np.inf,
        ubg: ArrayLike = np.inf,
    ) -> MPCC:
        """Append unknowns, parameters, constraint rows and pairs, and add a term to the objective.

        Bounds are those of the appended unknowns and rows. Expressions may use old and new symbols; those of
        an MPCC that was built by name are in ``parts``. Assembled derivatives of what was there are kept, as
        by :meth:`rmesh_nlp.optimize.nlp.NLP.extended`.

        Raises
        ------
        ValueError
            As the constructor.
        """
        kind = type(self.x)
        new = {"x": x, "p": p, "g": g, "G": G, "H": H}
        new_x, new_p, new_g, new_G, new_H = (_column(name, part, kind) for name, part in new.items())
        kept = np.zeros(self.n_g + 2 * self.n_pairs)
        oracle = NLP(
            self.x, self.p, self.f, ca.vertcat(self.g, self.G, self.H), self.lbx,
            self.ubx, kept, kept, self.derivatives,
        ).extended(x=new_x, p=new_p, f=f, g=ca.vertcat(new_g, new_G, new_H), lbx=lbx, ubx=ubx)  # fmt: skip
        columns = self.g, self.G, self.H, new_g, new_G, new_H
        part = np.repeat(2 * [0, 1, 2], [column.shape[0] for column in columns])
        ordered = oracle.extended(rows=np.argsort(part, kind="stable").tolist())
        return replace(
            self, x=oracle.x, p=oracle.p, f=oracle.f, g=ca.vertcat(self.g, new_g),
            G=ca.vertcat(self.G, new_G), H=ca.vertcat(self.H, new_H), lbx=oracle.lbx, ubx=oracle.ubx,
            lbg=longer(self.lbg, lbg, new_g), ubg=longer(self.ubg, ubg, new_g),
            derivatives=ordered.derivatives, completions=self.completions if new_x.is_empty() else {},
        )  # fmt: skip

    @classmethod
    def mixed(
        cls,
        *problem: Any,
        lbG: ArrayLike = -np.inf,
        ubG: ArrayLike = np.inf,
        lbH: ArrayLike = -np.inf,
        ubH: ArrayLike = np.inf,
        **others: Any,
    ) -> MPCC:
        """An MPCC whose pairs have bounds of their own: ``lbG <= G <= ubG _|_ lbH <= H <= ubH``.

        For each pair two of the four bounds are finite, see :mod:`rmesh_nlp.mpcc.mixed`. Pairs with both
        bounds on one side get two new unknowns each, after the user's; a start ``x0`` may leave them out.
        All other arguments are those of the constructor.

        Raises
        ------
        ValueError
            As the constructor, or if the bounds of a pair make no complementarity.
        """
        switches = others.pop("switches", None)
        given = cls(*problem, **others)
        bounds = zip(
            _bounds("G", lbG, ubG, given.n_pairs), _bounds("H", lbH, ubH, given.n_pairs), strict=True
        )
        members = ca.vertcat(given.G, given.H)
        bare, plain = replace(given, G=None, H=None), plain_pairs(members, *map(np.concatenate, bounds))
        return replace(_with_parts(bare, *plain), switches=switches)


def _with_parts(
    mpcc: MPCC, G: Symbolic, H: Symbolic, up: Symbolic, down: Symbolic, values: Symbolic, rows: Symbolic
) -> MPCC:
    """The MPCC with pairs, vanishing rows, and unknowns ``up, down >= 0`` for values ``up - down``."""
    longer = mpcc.extended(
        x=ca.vertcat(up, down), lbx=0, g=ca.vertcat(rows, values - up + down), lbg=0, ubg=0, G=G, H=H
    )
    parts = ca.Function("parts", [mpcc.x, mpcc.p], [ca.fmax(ca.vertcat(values, -values), 0)])
    return replace(longer, completions={**mpcc.completions, mpcc.n_x: parts})


def _split(mpcc: MPCC, switches: tuple[Symbolic, Symbolic]) -> MPCC:
    """The MPCC with products that vanish: any two of the four parts of a switch are a pair."""
    if len(switches) != 2:
        raise ValueError("switches must be two columns (r, d)")
    kind = type(mpcc.x)
    r, d = (_column("switches", part, kind) for part in switches)
    if (n := r.shape[0]) != d.shape[0]:
        raise ValueError(f"switches have {n} and {d.shape[0]} entries: they must pair up")
    up, down = (kind.sym(name, 2 * n) for name in ("up", "down"))
    (up_r, up_d), (down_r, down_d) = (ca.vertsplit(part, [0, n, 2 * n]) for part in (up, down))
    G, H = ca.vertcat(up, up_r, up_r, down_r, down_r), ca.vertcat(down, up_d, down_d, up_d, down_d)
    return _with_parts(mpcc, G, H, up, down, ca.vertcat(r, d), kind(0, 1))


def _numbers(name: str, value: object) -> Array:
    """``value`` as an array of numbers."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{name} must be numeric, got {value!r}"[:300]) from error


def _values(
    name: str, value: ArrayLike, n: int, finite: bool = False, symbols: Symbolic | None = None
) -> Array:
    """``value`` as a fresh array of length n without NaN, or all finite; a scalar stands for all.

    ``symbols`` are those whose values or bounds these are, for messages.
    """
    array = np.array(_numbers(name, value), dtype=float)
    array = np.full(n, float(array)) if array.ndim == 0 else array.ravel()
    if array.size != n:
        raise ValueError(f"{name} has length {array.size}, expected {n}")
    bad = np.flatnonzero(~np.isfinite(array) if finite else np.isnan(array))
    if bad.size:
        i = int(bad[0])
        what = "finite number" if finite else "number"
        raise ValueError(f"{named(symbols, i, name)} is {array[i]}, not a {what}")
    return array


def _column(name: str, value: Any, kind: type[Symbolic] | None) -> Symbolic:
    """``value`` (None, expression, number or list of them) as one column of ``kind``."""
    if value is None:
        return kind(0, 1) if kind is not None else None
    try:
        column = ca.vertcat(*value) if isinstance(value, (list, tuple)) else value
        if kind is not None:
            column = kind(0, 1) if isinstance(column, ca.DM) and column.is_empty() else kind(column)
    except (NotImplementedError, TypeError, RuntimeError) as error:
        raise ValueError(f"{name} must be a column of {kind.__name__ if kind else 'symbol'}s") from error
    if kind is None and type(column) not in (ca.SX, ca.MX):
        return column
    if column.is_empty():
        return type(column)(0, 1)
    if not column.is_column():
        if not column.is_row():
            raise ValueError(f"{name} must be a column, its shape is {column.shape}")
        column = column.T
    return column if name == "x" else ca.densify(column)


def _bounds(
    name: str, lower: ArrayLike, upper: ArrayLike, n: int, symbols: Symbolic | None = None
) -> tuple[Array, Array]:
    """Bounds as arrays of length n; raises a ValueError if there is no number between them."""
    lower = _values(f"lb{name}", lower, n, symbols=symbols)
    upper = _values(f"ub{name}", upper, n, symbols=symbols)
    wrong = np.flatnonzero((lower > upper) | (lower == np.inf) | (upper == -np.inf))
    if wrong.size:
        i = int(wrong[0])
        raise ValueError(
            f"{named(symbols, i, f'lb{name}')} = {lower[i]} and ub{name}[{i}] = {upper[i]} "
            "leave no value: the lower bound must not lie above the upper, "
            "and both cannot be the same infinity"
        )
    return lower, upper
