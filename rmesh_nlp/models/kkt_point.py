"""The contact problem linearised at a contact solution, and derivatives along its solutions.

With the member of each complementarity pair held that is zero, displacement, slip, forces and sums y are a
smooth function of the outer variables q, given by as many equations C(q, y) = 0: equilibrium, the sums, and
the held members. With the adjoint multipliers nu of a function F, ``C_y^T nu = -F_y``, and
``Lambda = F + nu^T C``,

    F' = F_q + C_q^T nu,      F'' d = Lambda_qq d + Lambda_qy y' + C_q^T nu',
    C_y y' = -C_q d,          C_y^T nu' = -(Lambda_yq d + Lambda_yy y'),

one factorisation of C_y, and two solves with it for each product (the second-order adjoint). They are the
derivatives of F wherever strict complementarity holds. Elsewhere the members of the biactive pairs that are
held are variables a of their own, C(q, y) = a, and F' has a part for each (:mod:`rmesh_nlp.models.branches`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from rmesh_nlp.contact.system import ActiveSet
from rmesh_nlp.evaluation import Array, Block, Index, Mask, Symmetric, is_finite
from rmesh_nlp.fem.assembly import Sums
from rmesh_nlp.models.kkt_model import Bilevel, ContactPoint
from rmesh_nlp.optimize.activity import ZERO


class KKTConditions:
    """Linearises the KKT model of one outer objective; the last point is remembered."""

    def __init__(self, program: Bilevel) -> None:
        self.program = program
        self._block = Block(program.assembled.first.pattern, slice(None), slice(None))
        self._last: tuple[ContactPoint, KKTPoint] | None = None

    @cached_property
    def hessian(self) -> tuple[Sums, Symmetric]:
        """The Hessian of the Lagrangian of the KKT model, and what makes a matrix of its nonzeros."""
        sums = self.program.assembled.second
        return sums, Symmetric(sums.pattern)

    def at(self, point: ContactPoint) -> KKTPoint:
        """The KKT point of a contact solution, whose active set is held."""
        if self._last is None or self._last[0].equilibrium is not point.equilibrium:
            x = self.program.point(point)
            (value,), slope, rows, nonzeros = self.program.assembled.first(x, None)
            jacobian = sp.csr_array(self._block(nonzeros))
            held = held_by(self.program, point.equilibrium.active)
            self._last = point, KKTPoint(self, x, float(value), slope, rows, jacobian, held)
        return self._last[1]


@dataclass(frozen=True, eq=False)
class KKTPoint:
    """An outer objective and the KKT conditions of the contact problem at unknowns ``x``, linearised.

    Attributes
    ----------
    value, slope
        The objective in the units of the model, and its derivatives by ``x``.
    rows, jacobian
        Values of g, G and H, and their derivatives by ``x``.
    held : bool array, optional
        The pairs of which G is held; by default those of which it is the smaller member.
    zero : float
        Pairs are biactive if both members are at most that.
    """

    conditions: KKTConditions
    x: Array
    value: float
    slope: Array
    rows: Array
    jacobian: sp.csr_array
    held: Mask | None
    zero: float = 0.0

    def over_branches(self, zero: float) -> KKTPoint:
        """The same with pairs that are biactive if both members are at most ``zero``, whatever was active."""
        return replace(self, held=None, zero=zero)

    @property
    def program(self) -> Bilevel:
        """The KKT model."""
        return self.conditions.program

    @cached_property
    def members(self) -> tuple[Mask, Mask]:
        """Of which pairs G is held, else H; and which pairs are biactive."""
        G, H = np.split(self.rows[self.program.n_g :], 2)
        return held_members(self.program, self.jacobian, G, H, self.zero, self.held)

    @cached_property
    def pairs(self) -> Index:
        """Numbers of the biactive pairs."""
        return np.flatnonzero(self.members[1])

    @cached_property
    def equations(self) -> Index:
        """Rows that determine y."""
        program = self.program
        first = program.n_g + np.arange(program.n_pairs)
        held = np.where(self.members[0], first, first + program.n_pairs)
        return np.concatenate([np.arange(program.n_equations), held])

    @cached_property
    def of_q(self) -> sp.csr_array:
        """C_q."""
        return self.jacobian[self.equations][:, : self.program.parts.n_q]

    @cached_property
    def factors(self) -> SuperLU | None:
        """Of C_y; None where it is singular or not defined."""
        if not is_finite(self.jacobian.data):
            return None
        try:
            return splu(sp.csc_array(self.jacobian[self.equations][:, self.program.parts.n_q :]))
        except RuntimeError:
            return None

    def multipliers(self, slopes: Array) -> Array:
        """Nu of functions with derivatives ``slopes`` (..., x.size); NaN where there are no factors."""
        if self.factors is None or slopes.size == 0:
            return np.full((*slopes.shape[:-1], self.equations.size), np.nan)
        return -self.factors.solve(slopes[..., self.program.parts.n_q :].T, "T").T

    def totals(self, slopes: Array) -> tuple[Array, Array]:
        """Derivatives by q, and by the held members of the biactive pairs, along contact solutions.

        They are those of functions with derivatives ``slopes`` (..., x.size).
        """
        nu = self.multipliers(slopes)
        by_q = slopes[..., : self.program.parts.n_q] + nu @ self.of_q
        return by_q, -nu[..., self.program.n_equations + self.pairs]

    @cached_property
    def constraints(self) -> tuple[Array, Array]:
        """The problem's constraints (rows,), and their derivatives (rows, n_q) along contact solutions."""
        first = self.program.n_equations
        rows = slice(first, first + self.program.constraints.size)
        by_q, _ = self.totals(self.jacobian[rows].toarray())
        return self.rows[rows], by_q

    def hessian(self, factor: float = 1.0, constraints: Array | None = None) -> ObjectiveHessian:
        """The second derivative of ``factor F + constraints . c``, c those of the problem, for products."""
        program = self.program
        slope, multipliers = factor * self.slope, np.zeros(self.rows.size)
        if constraints is not None:
            multipliers[program.n_equations : program.n_equations + program.constraints.size] = constraints
            slope = slope + self.jacobian.T @ multipliers
        multipliers[self.equations] = self.multipliers(slope)
        sums, symmetric = self.conditions.hessian
        (nonzeros,) = sums(self.x, None, np.array([factor]), multipliers)
        lagrangian = sp.csr_array(symmetric(nonzeros))
        return ObjectiveHessian(lagrangian, self.of_q, self.factors, program.parts.mesh_map.n_positions)


class ObjectiveHessian:
    """F'' at one point."""

    def __init__(
        self, lagrangian: sp.csr_array, of_q: sp.csr_array, factors: SuperLU | None, n_positions: int
    ) -> None:
        self._n_positions, n = n_positions, of_q.shape[1]
        self.qq = lagrangian[:n, :n]
        self._qy, self._yy = lagrangian[:n, n:], lagrangian[n:, n:]
        self._yq = self._qy.T.tocsr()
        self._of_q, self._of_q_t, self._factors = of_q, of_q.T.tocsr(), factors

    def diagonal(self) -> Array:
        """Size of the diagonal of Lambda_qq, of F'' for design variables, kept away from zero.

        Lambda may be linear in a modulus or a load.
        """
        diagonal, designs = self.qq.diagonal(), np.arange(self._n_positions, self.qq.shape[0])
        if designs.size:
            units = np.eye(diagonal.size)[:, designs]
            diagonal[designs] = self(units)[designs, np.arange(designs.size)]
        return positive(diagonal)

    def __call__(self, d: Array) -> Array:
        """``F'' d`` for a vector (n,), or for each column of a matrix (n, k)."""
        if self._factors is None:
            return np.full(d.shape, np.nan)
        y = -self._factors.solve(self._of_q @ d)
        nu = -self._factors.solve(self._yq @ d + self._yy @ y, "T")
        return self.qq @ d + self._qy @ y + self._of_q_t @ nu


def positive(diagonal: Array) -> Array:
    """Size of the diagonal, kept away from zero."""
    diagonal = np.abs(diagonal)
    return np.maximum(diagonal, 1e-3 * np.max(diagonal, initial=1e-300))


def held_by(program: Bilevel, active: ActiveSet) -> Mask:
    """The pairs whose first member an active set holds at zero: contact, stick, one side of what slides."""
    sliding = active.sliding[program.parts.friction_rows] if active.sliding.size else np.zeros(0)
    return np.concatenate([active.touching, sliding >= 0, sliding <= 0])


def held_members(
    program: Bilevel, jacobian: sp.csr_array, G: Array, H: Array, zero: float, held: Mask | None
) -> tuple[Mask, Mask]:
    """Which members of the pairs determine the contact solution, and which pairs are biactive.

    The first is True where G is held, else H is; with them the KKT conditions are a regular system. Without
    ``held`` it is the smaller member, and G of biactive pairs: contact, and stick. Three kinds of pairs look
    biactive and are not, because their other member has no effect: where displacements are given in the
    direction of a gap or slip; at nodes that carry no friction at all, whose slip variable s is ``|u_t|`` by
    convention; and where friction sets in with the contact force at a node that slides, whose one condition
    of its own is the contact pair.
    """
    n_c, n_s, n_u = program.parts.n_contact, program.parts.friction_rows.size, program.parts.n_u
    of_u = abs(jacobian[program.n_g : program.n_g + G.size, program.parts.n_q : program.parts.n_q + n_u])
    moves = of_u.max(axis=1).toarray().ravel() > ZERO if G.size and n_u else np.zeros(G.size, bool)
    zero_G, zero_H = np.maximum(H, zero) >= G, zero >= H
    biactive = zero_G & zero_H & (zero >= G)
    held = np.array(zero_G if held is None else held)
    gaps, minus, plus = slice(0, n_c), slice(n_c, n_c + n_s), slice(n_c + n_s, n_c + 2 * n_s)
    held[gaps] &= moves[gaps]
    biactive[gaps] &= moves[gaps]
    if n_s:
        is_open = ~held[gaps][program.parts.friction_rows]
        slips = np.abs(G[plus] - G[minus]) > zero
        bare = H[minus] + H[plus] <= zero  # no friction
        one_sided = ~moves[minus] | (bare & (is_open | slips))
        forward = G[minus] <= G[plus]
        held[minus] = np.where(one_sided, forward, held[minus])
        held[plus] = np.where(one_sided, ~forward, held[plus])
        biactive[minus] &= ~one_sided
        biactive[plus] &= ~one_sided
    return held, biactive
