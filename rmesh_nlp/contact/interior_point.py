"""An interior-point method for contact on a fixed mesh, at nodes or at any points.

Contact with friction bounds b is a convex quadratic program in x = (u, s), s the magnitudes of the slips,

    min 1/2 u^T K u - F^T u + b^T s   with   y = (N u + gamma, s - T u, s + T u) >= 0.

Mehrotra's predictor and corrector [1]_ solves it whatever the signs of the entries of K. The matrix of a step
is ``K + G^T diag(z / y) G``, with multipliers z >= 0 of ``y = G x + h``. Slips are eliminated from it, so
that it keeps its pattern.

.. [1] S. Mehrotra, On the implementation of a primal-dual interior point method, SIAM J. Optim. 2 (1992)
   575-601.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.factorisation import factorised
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import PROVED, Array, is_finite


def interior_point(system: ContactSystem, start: Equilibrium) -> Iterator[tuple[ActiveSet, Array]]:
    """The active set and the contact forces (gaps,) after each step, which takes one factorisation.

    Nodes touch where the force is larger than the gap, in units of the stiffness there, and stick where both
    multipliers of a slip are. The sets end when products of forces and gaps are too small for a number.
    """
    bound, gaps = system.slip_bound, system.offset.size
    slides = np.flatnonzero(system.rotated.slips & (bound > 0)) if bound.size else np.zeros(0, np.int64)
    rows = system.normals, system.tangents[slides]
    program = BarrierProgram(system.stiffness, system.load, *rows, bound[slides], lambda _: system.offset)
    _, below, above = (values[slides] for values in system.friction(start))
    first = np.abs(np.concatenate([start.normal_force, below, above]))
    for _, y, z in program.steps(start.u, first):
        touching, forward, backward = np.split(z > program.unit * y, [gaps, gaps + slides.size])
        sliding = np.zeros(bound.size, dtype=np.int8)
        sliding[slides] = forward.astype(np.int8) - backward
        yield ActiveSet(touching, sliding), z[:gaps]


STEPS = 60
"""Most steps to a displacement of least energy; 12 to 30 are usual."""


class BarrierProgram(NamedTuple):
    """The program for unknowns u (m,); the gap at zero displacement, gamma, may depend on u a little."""

    stiffness: sp.csc_array
    load: Array
    normals: sp.csr_array
    tangents: sp.csr_array
    bound: Array
    offset: Callable[[Array], Array]

    @property
    def unit(self) -> Array:
        """Stiffness of each member of y; tools, which have none, count like the body at its stiffest."""
        rows, stiffness = sp.vstack([self.normals, self.tangents, self.tangents]), self.stiffness.diagonal()
        most = np.max(stiffness, initial=0.0)
        return abs(rows) @ np.where(stiffness > 0, stiffness, most)

    def minimised(self, u: Array) -> Array:
        """The unknowns of least energy, up to ``PROVED`` of it, from u on."""
        best, least, small = u, np.inf, PROVED * float(u @ (self.stiffness @ u))
        first = np.concatenate([np.zeros(self.normals.shape[0]), *[self.bound / 2] * 2])
        for x, y, z in islice(self.steps(u, first), STEPS):
            if y @ z < least:
                best, least = x, float(y @ z)
            if least <= small:
                break
        return best

    def steps(self, u: Array, z: Array) -> Iterator[tuple[Array, Array, Array]]:
        """Unknowns u, y and z after each step, from u and from about these multipliers.

        They end where products of y and z are too small for a number, or no gap prevents some rigid motion.
        """
        s, unit = np.abs(self.tangents @ u), np.sqrt(self.unit)
        y = self._members(u, s)
        inside = np.mean(np.abs(y) * unit + z / unit)  # the same whatever the units of single unknowns
        y, z = np.abs(y) + inside / unit, z + inside * unit
        while np.all(y * z > 0) and is_finite(z / y):
            try:
                u, s, y, z = self._step(u, s, y, z)
            except RuntimeError:  # singular
                return
            yield u, y, z

    def _members(self, u: Array, s: Array) -> Array:
        slip = self.tangents @ u
        return np.concatenate([self.normals @ u + self.offset(u), s - slip, s + slip])

    def _pulls(self, z: Array) -> tuple[Array, Array]:
        """What multipliers do to u and s: ``G^T z``."""
        normal, below, above = np.split(z, self._parts)
        return self.normals.T @ normal + self.tangents.T @ (above - below), below + above

    @property
    def _parts(self) -> list[int]:
        gaps = self.normals.shape[0]
        return [gaps, gaps + self.bound.size]

    def _step(self, u: Array, s: Array, y: Array, z: Array) -> tuple[Array, Array, Array, Array]:
        """A predictor and a corrector."""
        N, T, (pull, held) = self.normals, self.tangents, self._pulls(z)
        unbalanced, apart = self.stiffness @ u - self.load - pull, self._members(u, s) - y
        normal, below, above = np.split(z / y, self._parts)
        both, turn = below + above, (above - below) / (below + above)
        springs = N.T @ sp.diags_array(normal) @ N
        springs += T.T @ sp.diags_array(4 * below * above / np.maximum(both, 1e-300)) @ T
        solve = factorised(sp.csc_array(self.stiffness + springs))

        def newton(change: Array) -> tuple[Array, Array, Array, Array]:
            """The step that changes the products y z, to first order."""
            on_u, on_s = self._pulls((change - z * apart) / y)
            on_s = on_s + held - self.bound
            du = solve(on_u - unbalanced - T.T @ (turn * on_s))
            slip = T @ du
            ds = on_s / both - turn * slip
            dy = np.concatenate([N @ du, ds - slip, ds + slip]) + apart
            return du, ds, dy, (change - z * dy) / y

        def taken(dy: Array, dz: Array, most: float) -> float:
            """The part of a step, at most one, that goes ``most`` of the way to where y or z vanishes."""
            return most / max(most, np.max(-dy / y), np.max(-dz / z))

        *_, dy, dz = newton(-y * z)
        part, mean = taken(dy, dz, 1.0), np.mean(y * z)
        ahead = np.mean((y + part * dy) * (z + part * dz))
        centred = ahead * (ahead / mean) ** 2
        du, ds, dy, dz = newton(centred - dy * dz - y * z)
        part = taken(dy, dz, 0.995)
        return u + part * du, s + part * ds, y + part * dy, z + part * dz
