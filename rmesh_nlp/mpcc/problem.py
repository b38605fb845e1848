"""The mathematical program with complementarity constraints (MPCC), checked at the door.

Form and signs::

    minimise f(x, p)   subject to   lbg <= g(x, p) <= ubg,   lbx <= x <= ubx,
                                    0 <= G(x, p)  _|_  H(x, p) >= 0   componentwise,

that is ``G_i >= 0``, ``H_i >= 0`` and ``G_i H_i = 0`` for every pair i.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mpcc.checks import bound, checked, column, numbers, refuse_crossing, refuse_free_symbols
from rmesh_nlp.mpcc.extension import extended_derivatives
from rmesh_nlp.mpcc.mixed import completion, pair_bound, split
from rmesh_nlp.optimize.nlp import NLP, Derivatives


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
    completion : casadi.Function, optional
        ``(x, p) -> starts`` of the last unknowns, which :meth:`mixed` has added to the user's: a start
        may then be given for the user's own unknowns alone, which come first.
    parts : mapping of str to expression, optional
        Parts of the unknowns by name.

    Raises
    ------
    ValueError
        If x is not symbolic, f is not scalar, an expression has free symbols, G and H differ in
        length, or a bound has the wrong length, is NaN, or lies above its partner.
    """

    x: Any
    f: Any
    g: Any
    G: Any
    H: Any
    lbx: ArrayLike = -np.inf
    ubx: ArrayLike = np.inf
    lbg: ArrayLike = -np.inf
    ubg: ArrayLike = np.inf
    p: Any = None
    derivatives: Derivatives | None = None
    completion: ca.Function | None = None
    parts: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        kind = type(self.x).__name__
        p = f", {self.p.shape[0]} parameters" if self.p.shape[0] else ""
        return (
            f"MPCC({self.n_x} unknowns, {self.n_g} constraints, {self.n_pairs} complementarity pairs{p}; "
            f"{kind} expressions x, f, g, G, H)"
        )

    def __post_init__(self) -> None:
        x = column("x", self.x, None)
        kind = type(x)
        if kind not in (ca.SX, ca.MX) or not x.is_valid_input():
            raise ValueError(f"x must be a column of CasADi SX or MX symbols, got {self.x!r}"[:300])
        columns = {name: column(name, getattr(self, name), kind) for name in ("f", "g", "G", "H", "p")}
        columns["x"] = x
        if columns["f"].shape != (1, 1):
            raise ValueError(f"f must be a scalar expression, its shape is {columns['f'].shape}")
        if not columns["p"].is_valid_input():
            raise ValueError("p must be a column of symbols")
        n_G, n_H = columns["G"].shape[0], columns["H"].shape[0]
        if n_G != n_H:
            raise ValueError(f"G has length {n_G} and H has length {n_H}: they must pair up")
        refuse_free_symbols(columns)
        for name, value in columns.items():
            object.__setattr__(self, name, value)
        for name, n in (("x", x.shape[0]), ("g", columns["g"].shape[0])):
            lower = bound(f"lb{name}", getattr(self, f"lb{name}"), n)
            upper = bound(f"ub{name}", getattr(self, f"ub{name}"), n)
            refuse_crossing(name, lower, upper)
            object.__setattr__(self, f"lb{name}", lower)
            object.__setattr__(self, f"ub{name}", upper)
        self._check_derivatives()

    def _check_derivatives(self) -> None:
        """The assembled constraint column must be as long as vertcat(g, G, H)."""
        if self.derivatives is None:
            return
        expected = (self.n_g + 2 * self.n_pairs, self.n_x)
        got = self.derivatives.jac_g.size_out(1)
        if tuple(got) != expected:
            raise ValueError(
                f"derivatives.jac_g gives a Jacobian of shape {tuple(got)}, vertcat(g, G, H) needs {expected}"
            )

    def extended(
        self,
        *,
        x: Any = None,
        p: Any = None,
        f: Any = 0,
        g: Any = None,
        G: Any = None,
        H: Any = None,
        lbx: ArrayLike = -np.inf,
        ubx: ArrayLike = np.inf,
        lbg: ArrayLike = -np.inf,
        ubg: ArrayLike = np.inf,
    ) -> MPCC:
        """Append unknowns, parameters, constraint rows and pairs, and add a term to the objective.

        Assembled derivatives of what was there are kept, as by :meth:`rmesh_nlp.optimize.nlp.NLP.extended`.
        Expressions may use old and new symbols; those of a program that was built by name are in ``parts``.

        Parameters
        ----------
        x, p : symbols to append to the unknowns and to the parameters
        f : term added to the objective
        g : rows appended to the constraints
        G, H : members of further pairs
        lbx, ubx, lbg, ubg : bounds of the appended unknowns and rows

        Raises
        ------
        ValueError
            As the constructor.
        """
        kind = type(self.x)
        empty = kind(0, 1)
        new_x, new_p = (empty if part is None else ca.vertcat(part) for part in (x, p))
        rows = [empty if part is None else ca.vertcat(kind(part)) for part in (g, G, H)]
        derivatives = None
        if self.derivatives is not None:
            none = np.zeros(0)
            column = ca.vertcat(self.g, self.G, self.H)
            oracle = NLP(self.x, self.p, self.f, column, none, none, none, none, self.derivatives)
            derivatives = extended_derivatives(
                oracle, new_x, new_p, kind(f), (rows[0], rows[1], rows[2]), (self.n_g, self.n_pairs)
            )
        bounds: dict[str, Any] = {
            name: np.append(getattr(self, name), np.broadcast_to(np.asarray(value, dtype=float), (size,)))
            for name, value, size in (
                ("lbx", lbx, int(new_x.shape[0])),
                ("ubx", ubx, int(new_x.shape[0])),
                ("lbg", lbg, int(rows[0].shape[0])),
                ("ubg", ubg, int(rows[0].shape[0])),
            )
        }
        return replace(
            self,
            x=ca.vertcat(self.x, new_x),
            p=ca.vertcat(self.p, new_p),
            f=self.f + f,
            g=ca.vertcat(self.g, rows[0]),
            G=ca.vertcat(self.G, rows[1]),
            H=ca.vertcat(self.H, rows[2]),
            derivatives=derivatives,
            completion=None,
            **bounds,
        )

    @property
    def n_x(self) -> int:
        """Number of unknowns."""
        return int(self.x.shape[0])

    @property
    def n_g(self) -> int:
        """Number of ordinary constraints."""
        return int(self.g.shape[0])

    @property
    def n_pairs(self) -> int:
        """Number of complementarity pairs."""
        return int(self.G.shape[0])

    @property
    def n_own(self) -> int:
        """Number of the user's own unknowns; :meth:`mixed` may add others after them."""
        return self.n_x - (0 if self.completion is None else int(self.completion.numel_out(0)))

    @classmethod
    def mixed(
        cls,
        x: Any,
        f: Any,
        g: Any = None,
        G: Any = None,
        H: Any = None,
        *,
        lbG: ArrayLike = -np.inf,
        ubG: ArrayLike = np.inf,
        lbH: ArrayLike = -np.inf,
        ubH: ArrayLike = np.inf,
        lbx: ArrayLike = -np.inf,
        ubx: ArrayLike = np.inf,
        lbg: ArrayLike = -np.inf,
        ubg: ArrayLike = np.inf,
        p: Any = None,
    ) -> MPCC:
        """An MPCC whose pairs have bounds of their own: ``lbG <= G <= ubG _|_ lbH <= H <= ubH``.

        For each pair two of the four bounds are finite, see :mod:`rmesh_nlp.mpcc.mixed`. Pairs with both
        bounds on one side get two new unknowns each, after the user's; a start ``x0`` may leave them out.

        Raises
        ------
        ValueError
            As the constructor, or if the bounds of a pair make no complementarity.
        """
        plain = cls(x, f, g, G, H, lbx, ubx, lbg, ubg, p)
        n = plain.n_pairs
        named = (("lbG", lbG), ("ubG", ubG), ("lbH", lbH), ("ubH", ubH))
        lower_G, upper_G, lower_H, upper_H = (pair_bound(name, value, n) for name, value in named)
        for name, low, high in (("G", lower_G, upper_G), ("H", lower_H, upper_H)):
            wrong = np.flatnonzero(low > high)
            if wrong.size:
                i = int(wrong[0])
                raise ValueError(f"lb{name}[{i}] = {low[i]} lies above ub{name}[{i}] = {high[i]}")
        parts = split(type(plain.x), plain.G, plain.H, (lower_G, upper_G, lower_H, upper_H))
        n_new, n_rows = len(parts.unknowns), len(parts.rows)
        return cls(
            [plain.x, *parts.unknowns], plain.f, [plain.g, *parts.rows], parts.firsts, parts.seconds,
            lbx=np.append(np.asarray(plain.lbx), np.zeros(n_new)),
            ubx=np.append(np.asarray(plain.ubx), np.full(n_new, np.inf)),
            lbg=np.append(np.asarray(plain.lbg), np.zeros(n_rows)),
            ubg=np.append(np.asarray(plain.ubg), np.zeros(n_rows)),
            p=plain.p,
            completion=completion(plain.x, plain.p, parts),
        )  # fmt: skip

    @classmethod
    def from_nlp(
        cls,
        nlp: Mapping[str, Any],
        pairs: Sequence[tuple[tuple[str, int], tuple[str, int]]],
        *,
        lbx: ArrayLike = -np.inf,
        ubx: ArrayLike = np.inf,
        lbg: ArrayLike = -np.inf,
        ubg: ArrayLike = np.inf,
    ) -> MPCC:
        """An NLP in the form of ``nlpsol``, of which some rows and unknowns complement each other.

        Parameters
        ----------
        nlp : mapping
            ``x``, ``f`` and perhaps ``g`` and ``p``: CasADi expressions.
        pairs : sequence
            Each pair names its members, ``(("g", 3), ("x", 0))``: row 3 of g and unknown 0. Their
            bounds are those of the NLP, with the meaning of :meth:`mixed`; paired rows leave g.
        lbx, ubx, lbg, ubg : array_like

        Raises
        ------
        ValueError
            If a member does not exist or a row is paired twice.
        """
        unknown = set(nlp) - {"x", "f", "g", "p"}
        if unknown or "x" not in nlp or "f" not in nlp:
            raise ValueError(f"nlp has the keys {sorted(nlp)}: x and f are needed, g and p may be given")
        plain = cls(nlp["x"], nlp["f"], nlp.get("g"), None, None, lbx, ubx, lbg, ubg, nlp.get("p"))
        columns = {"x": (plain.x, plain.lbx, plain.ubx), "g": (plain.g, plain.lbg, plain.ubg)}
        members: list[list[Any]] = [[], []]
        bounds: list[list[float]] = [[], [], [], []]
        taken: set[int] = set()
        for k, pair in enumerate(pairs):
            for side, (kind, i) in enumerate(pair):
                if kind not in columns or not 0 <= i < columns[kind][0].shape[0]:
                    raise ValueError(f"pair {k}: there is no {kind}[{i}]")
                if kind == "g" and i in taken:
                    raise ValueError(f"pair {k}: row g[{i}] is already in a pair")
                taken |= {i} if kind == "g" else set()
                column, lower, upper = columns[kind]
                members[side].append(column[i])
                bounds[2 * side].append(float(np.asarray(lower)[i]))
                bounds[2 * side + 1].append(float(np.asarray(upper)[i]))
        kept = [i for i in range(plain.n_g) if i not in taken]
        return cls.mixed(
            plain.x, plain.f, plain.g[kept] if kept else None, members[0], members[1],
            lbG=bounds[0], ubG=bounds[1], lbH=bounds[2], ubH=bounds[3],
            lbx=np.asarray(plain.lbx), ubx=np.asarray(plain.ubx),
            lbg=np.asarray(plain.lbg)[kept], ubg=np.asarray(plain.ubg)[kept], p=plain.p,
        )  # fmt: skip

    def start(self, x0: ArrayLike, p: ArrayLike = ()) -> Array:
        """Return ``x0`` as a checked array; a scalar fills it, what :meth:`mixed` added is completed."""
        if self.completion is None or np.size(numbers("x0", x0)) == self.n_x:
            return checked("x0", x0, self.n_x, "unknowns")
        own = checked("x0", x0, self.n_own, "unknowns of its own")
        added = np.asarray(self.completion(own, self.parameters(p))).ravel()
        return np.append(own, np.nan_to_num(added))

    def parameters(self, p: ArrayLike) -> Array:
        """Return the values of ``p`` as a checked array."""
        return checked("p", p, int(self.p.shape[0]), "parameters")
