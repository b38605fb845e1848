"""An interior-point method for contact on a fixed mesh, at nodes or at any points.

Contact with friction bounds b is a convex quadratic program in x = (u, s), s the magnitudes of the slips,

    min 1/2 u^T K u - F^T u + b^T s   with   y = (N u + gamma, s - T u, s + T u) >= 0.

Mehrotra's predictor and corrector [1]_ solves it whatever the signs of the entries of K, corrected further
where that lengthens the step [2]_. The matrix of a step is ``K + G^T diag(z / y) G``, with multipliers z >= 0
of ``y = G x + h``. Slips are eliminated from it, so that it keeps its pattern.

.. [1] S. Mehrotra, On the implementation of a primal-dual interior point method, SIAM J. Optim. 2 (1992)
   575-601.
.. [2] T. J. Carpenter, I. J. Lustig, J. M. Mulvey, D. F. Shanno, Higher-order predictor-corrector interior
   point methods with application to quadratic objectives, SIAM J. Optim. 3 (1993) 696-725.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.contact.factorisation import factorised
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import PROVED, Array, is_finite


def interior_point(system: ContactSystem, start: Equilibrium) -> Iterator[tuple[ActiveSet, Array]]:
    """The active set and the contact forces (gaps,) after each step, which takes one factorisation.

    Nodes touch where the force is larger than the gap, in units of the stiffness there, and stick where both
    multipliers of a slip are. The sets end when products of forces and gaps are too small for a number.
    """
    bound = system.slip_bound
    slides = np.flatnonzero(system.rotated.slips & (bound > 0))
    program = BarrierProgram(
        system.stiffness,
        system.load,
        system.normals,
        system.tangents[slides],
        bound[slides],
        lambda _: system.offset,
    )
    for _, y, z in program.steps(start.u, start.normal_force):
        touching, forward, backward = program.split(z > program.unit * y)
        sliding = np.zeros(bound.size, dtype=np.int8)
        sliding[slides] = forward.astype(np.int8) - backward
        yield ActiveSet(touching, sliding), program.split(z)[0]


STEPS = 60
"""Most steps to a displacement of least energy; 12 to 30 are usual."""


@dataclass(frozen=True)
class BarrierProgram:
    """The program for unknowns u (m,); the gap at zero displacement, gamma, may depend on u a little."""

    stiffness: sp.csc_array
    load: Array
    normals: sp.csr_array
    tangents: sp.csr_array
    bound: Array
    offset: Callable[[Array], Array]

    @cached_property
    def unit(self) -> Array:
        """Stiffness of each member of y; tools, which have none, count like the body at its stiffest."""
        rows, stiffness = sp.vstack([self._rows, self.tangents]), self.stiffness.diagonal()
        most = np.max(stiffness, initial=0.0)
        return abs(rows) @ np.where(stiffness > 0, stiffness, most)

    @cached_property
    def _rows(self) -> sp.csr_array:
        """N, then T."""
        return sp.vstack([self.normals, self.tangents], "csr")

    def minimised(self, u: Array) -> Array:
        """The unknowns of least energy, up to ``PROVED`` of it, from u on."""
        if not self.unit.size:
            return u
        strain, normal = float(u @ (self.stiffness @ u)), np.zeros(self.normals.shape[0])
        best, least, small = u, np.inf, PROVED * strain
        for x, y, z in islice(self.steps(u, normal, strain / (10 * self.unit.size)), STEPS):
            if y @ z < least:
                best, least = x, float(y @ z)
            if least <= small:
                break
        return best

    def steps(self, u: Array, normal: Array, energy: float | None = None) -> Iterator[tuple[Array, ...]]:
        """Unknowns u, y and z after each step, from u and from about these contact forces.

        The products of y and z begin with an energy, or with that of what u is not admissible by; by default
        with that of gaps and forces. They end where these are too small for a number, or no gap prevents some
        rigid motion.
        """
        s, unit = np.abs(self.tangents @ u), np.sqrt(self.unit)
        y, z = self._members(u, s), np.concatenate([np.abs(normal), self.bound / 2, self.bound / 2])
        inside = np.abs(y) * unit + z / unit if energy is None else np.maximum(-y, 0.0) * unit
        energy = max(energy or 0.0, np.mean(inside) ** 2)  # whatever the units of single unknowns
        y = np.abs(y) + np.sqrt(energy) / unit
        z = z + energy / np.maximum(y, 1e-300)  # nothing to do where all are zero
        while np.all(y * z > 0) and is_finite(z / y):
            try:
                with np.errstate(over="ignore", invalid="ignore"):  # where nothing is least
                    u, s, y, z = self._step(u, s, y, z)
            except RuntimeError:  # singular
                return
            yield u, y, z

    def _members(self, u: Array, s: Array) -> Array:
        return self._changes(u, s) + np.append(self.offset(u), np.zeros(2 * s.size))

    def _changes(self, u: Array, s: Array) -> Array:
        """``G x``."""
        slip = self.tangents @ u
        return np.concatenate([self.normals @ u, s - slip, s + slip])

    def split(self, of_members: NDArray) -> list[NDArray]:
        """Those of gaps, and of slips below and above."""
        gaps = self.normals.shape[0]
        return np.split(of_members, [gaps, gaps + self.bound.size])

    def _step(self, u: Array, s: Array, y: Array, z: Array) -> tuple[Array, ...]:
        """A predictor and correctors."""
        apart = self._members(u, s) - y
        normal, below, above = self.split(z / y)
        both, turn = below + above, (above - below) / (below + above)
        least, most = np.minimum(below, above), np.maximum(below, above)  # whose product may overflow
        springs = np.append(normal, 4 * least / (1 + least / np.maximum(most, 1e-300)))
        scaled = self._rows.tocsc()  # both factors of the product by columns: a third of the time
        scaled.data *= springs[scaled.indices]
        solve = factorised(self.stiffness + self._rows.T @ scaled)
        residual = self.stiffness @ u - self.load

        def newton(change: Array) -> tuple[Array, ...]:
            """The step that changes the products y z, to first order."""
            normal, below, above = self.split(z + (change - z * apart) / y)
            on_s = below + above - self.bound
            du = solve(self._rows.T @ np.append(normal, above - below - turn * on_s) - residual)
            slip = self.tangents @ du
            ds = on_s / both - turn * slip
            dy = self._changes(du, ds) + apart
            return du, ds, dy, (change - z * dy) / y

        def taken(step: tuple[Array, ...], most: float = 1.0) -> float:
            """The part of a step, at most one, that goes ``most`` of the way to where y or z vanishes."""
            return most / max(most, np.max(-step[2] / y), np.max(-step[3] / z))

        step = newton(-y * z)
        part = taken(step)
        ahead = np.mean((y + part * step[2]) * (z + part * step[3]))
        centred = ahead * (ahead / np.mean(y * z)) ** 2
        for number in range(3):
            other = newton(centred - step[2] * step[3] - y * z)
            if number and taken(other) <= taken(step):
                break
            step = other
        part = taken(step, 0.995)
        return tuple(x + part * by for x, by in zip((u, s, y, z), step, strict=True))
