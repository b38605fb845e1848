"""The contact problem linearised at a contact solution, and derivatives along its solutions.

With the member of each complementarity pair held that is zero, displacement, slip, forces and sums y are a
smooth function of the outer variables q, given by as many equations C(q, y) = 0: equilibrium, the sums, and
the held members. With the adjoint multipliers nu of a function F, ``C_y^T nu = -F_y``, and
``Lambda = F + nu^T C``,

    F' = F_q + C_q^T nu,      F'' d = Lambda_qq d + Lambda_qy y' + C_q^T nu',
    C_y y' = -C_q d,          C_y^T nu' = -(Lambda_yq d + Lambda_yy y'),

two solves with C_y for each product (the second-order adjoint), by the factors of the contact solve
(:class:`Factors`). They are the derivatives of F wherever strict complementarity holds.
Elsewhere the members of the biactive pairs that are held are variables a of their own, C(q, y) = a, and F'
has a part for each (:mod:`rmesh_nlp.models.branches`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from rmesh_nlp.contact.system import ActiveSet, RotatedSystem
from rmesh_nlp.evaluation import Array, Block, Index, Mask, Symmetric, is_finite
from rmesh_nlp.fem.assembly import Sums
from rmesh_nlp.models.kkt_model import Bilevel, ContactPoint
from rmesh_nlp.models.second_derivatives import Hessian


class KKTConditions:
    """Linearises the KKT model of one outer objective; the last point is remembered."""

    def __init__(self, program: Bilevel) -> None:
        self.program = program
        self._block = Block(program.assembled.first.pattern)
        self._last: KKTPoint | None = None

    @cached_property
    def hessian(self) -> tuple[Sums, Symmetric]:
        """The Hessian of the Lagrangian of the KKT model, and what makes a matrix of its nonzeros."""
        sums = self.program.assembled.second
        return sums, Symmetric(sums.pattern)

    def at(self, point: ContactPoint) -> KKTPoint:
        """The KKT point of a contact solution, whose active set is held."""
        if self._last is None or self._last.contact.equilibrium is not point.equilibrium:
            x = self.program.point(point)
            (value,), slope, rows, nonzeros = self.program.assembled.first(x, None)
            jacobian = sp.csr_array(self._block(nonzeros))
            active, rows_of_friction = point.equilibrium.active, self.program.parts.friction_rows
            sliding = active.sliding[rows_of_friction]
            # contact, stick, one side of what slides
            held = np.concatenate([active.touching, sliding >= 0, sliding <= 0])
            self._last = KKTPoint(self, point, x, float(value), slope, rows, jacobian, held)
        return self._last


class Factors:
    """The KKT conditions C_y, factorised.

    In the coordinates of the contact system their Schur complement over the displacements that contact leaves
    free is the stiffness that the contact solve has factorised, in units of its own. Held displacements and
    forces, which few conditions couple, have factors of their own.
    """

    def __init__(
        self, conditions: sp.csr_array, rotated: RotatedSystem, active: ActiveSet, unit: float
    ) -> None:
        self._unit, self._free = unit, rotated.factor(active)
        others = sp.eye_array(conditions.shape[0] - rotated.basis.shape[0])
        self._turn = sp.block_diag([rotated.basis, others], format="csr")
        conditions = self._turn.T @ conditions @ self._turn
        inside = self._free.inside
        self._others = np.delete(np.arange(conditions.shape[0]), inside)
        others = sp.csc_array(conditions[self._others])
        self._local = splu(others[:, self._others])
        self._couplings = others[:, inside], conditions[inside][:, self._others]

    def __call__(self, right: Array, transposed: bool) -> Array:
        """Solutions with the conditions, or with their transpose."""
        (down, up), free, trans = self._couplings, self._free.solve, "N"
        if transposed:
            (down, up), free, trans = (up.T, down.T), self._free.transposed, "T"
        right = self._turn.T @ right
        others, result = self._local.solve(right[self._others], trans), np.empty(right.shape)
        result[self._free.inside] = inside = self._unit * free(right[self._free.inside] - up @ others)
        result[self._others] = others - self._local.solve(down @ inside, trans)
        return self._turn @ result


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
    contact: ContactPoint
    x: Array
    value: float
    slope: Array
    rows: Array
    jacobian: sp.csr_array
    held: Mask | None
    zero: float = 0.0

    @property
    def program(self) -> Bilevel:
        """The KKT model."""
        return self.conditions.program

    @cached_property
    def members(self) -> tuple[Mask, Mask]:
        """Which members of the pairs determine the contact solution, and which pairs are biactive.

        The first is True where G is held, else H is; with them the KKT conditions are a regular system.
        Without ``held`` it is the smaller member, and G of biactive pairs: contact, and stick. Three kinds of
        pairs look biactive and are not, because their other member has no effect: where displacements are
        given in the direction of a gap or slip; at nodes that carry no friction at all, whose slip variable s
        is ``|u_t|`` by convention; and where friction sets in with the contact force at a node that slides,
        whose one condition of its own is the contact pair.
        """
        program, system, zero = self.program, self.contact.system, self.zero
        G, H = self.rows[program.rows["G"]], self.rows[program.rows["H"]]
        gaps, minus, plus = program.parts.pairs.places.values()
        friction_rows = program.parts.friction_rows
        moves = np.diff(system.normals.indptr) > 0
        turns = np.diff(system.tangents.indptr)[friction_rows] > 0
        zero_G, zero_H = np.maximum(H, zero) >= G, zero >= H
        biactive = zero_G & zero_H & (zero >= G)
        held = np.array(zero_G if self.held is None else self.held)
        held[gaps] &= moves
        biactive[gaps] &= moves
        is_open = ~held[gaps][friction_rows]
        slips = np.abs(G[plus] - G[minus]) > zero
        bare = H[minus] + H[plus] <= zero  # no friction
        one_sided = ~turns | (bare & (is_open | slips))
        forward = G[minus] <= G[plus]
        held[minus] = np.where(one_sided, forward, held[minus])
        held[plus] = np.where(one_sided, ~forward, held[plus])
        biactive[minus] &= ~one_sided
        biactive[plus] &= ~one_sided
        return held, biactive

    @cached_property
    def pairs(self) -> Index:
        """Numbers of the biactive pairs."""
        return np.flatnonzero(self.members[1])

    @cached_property
    def equations(self) -> Index:
        """Rows that determine y."""
        every, rows = np.arange(self.rows.size), self.program.rows
        pairs = np.where(self.members[0], every[rows["G"]], every[rows["H"]])
        return np.concatenate([every[: self.program.n_equations], pairs])

    @cached_property
    def factors(self) -> Factors | None:
        """Of C_y; None where it is singular or not defined."""
        parts = self.program.parts
        touching, minus, plus = parts.pairs.split(self.members[0])
        sliding = np.zeros(parts.n_contact, dtype=np.int8)
        sliding[parts.friction_rows] = minus.astype(np.int8) - plus
        if not is_finite(self.jacobian.data):
            return None
        conditions = self.jacobian[self.equations][:, parts.n_q :]
        unit = self.program.force / self.program.length
        try:
            return Factors(conditions, self.contact.system.rotated, ActiveSet(touching, sliding), unit)
        except RuntimeError:
            return None

    def solve(self, right: Array, transposed: bool = False) -> Array:
        """Solutions with C_y, or with its transpose; NaN where there are no factors."""
        return np.full(right.shape, np.nan) if self.factors is None else self.factors(right, transposed)

    def along(self, slopes: Array, nu: Array) -> Array:
        """``F_q + C_q^T nu``, each (..., n)."""
        every = np.zeros((*nu.shape[:-1], self.rows.size))
        every[..., self.equations] = nu
        n_q = self.program.parts.n_q
        return slopes[..., :n_q] + (self.jacobian.T @ every.T)[:n_q].T

    def multipliers(self, slopes: Array) -> Array:
        """Nu of functions with derivatives ``slopes`` (..., x.size)."""
        return -self.solve(slopes[..., self.program.parts.n_q :].T, transposed=True).T

    def totals(self, slopes: Array) -> tuple[Array, Array]:
        """Derivatives by q, and by the held members of the biactive pairs, along contact solutions.

        They are those of functions with derivatives ``slopes`` (..., x.size).
        """
        nu = self.multipliers(slopes)
        return self.along(slopes, nu), -nu[..., self.program.n_equations + self.pairs]

    @cached_property
    def constraints(self) -> tuple[Array, Array]:
        """The problem's constraints (rows,), and their derivatives (rows, n_q) along contact solutions."""
        rows = self.program.rows["constraints"]
        by_q, _ = self.totals(self.jacobian[rows].toarray())
        return self.rows[rows], by_q

    def hessian(self, factor: float = 1.0, constraints: Array | None = None) -> Hessian:
        """The second derivative of ``factor F + constraints . c``, c those of the problem, for products."""
        program, n_q = self.program, self.program.parts.n_q
        slope, multipliers = factor * self.slope, np.zeros(self.rows.size)
        if constraints is not None:
            multipliers[program.rows["constraints"]] = constraints
            slope = slope + self.jacobian.T @ multipliers
        multipliers[self.equations] = self.multipliers(slope)
        sums, symmetric = self.conditions.hessian
        (nonzeros,) = sums(self.x, None, np.array([factor]), multipliers)
        lagrangian, by_q = sp.csr_array(symmetric(nonzeros)), self.jacobian[:, :n_q]

        def products(d: Array) -> Array:
            y = -self.solve((by_q @ d)[self.equations])
            change = (lagrangian @ np.concatenate([d, y])).T
            return self.along(change, self.multipliers(change)).T

        return Hessian(lagrangian[:n_q, :n_q], program.parts.mesh_map.n_positions, products)
