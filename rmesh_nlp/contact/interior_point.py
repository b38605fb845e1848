"""An interior-point method for contact on a fixed mesh, which names active sets.

Contact with friction bounds b is a convex quadratic program in x = (u, s), s the magnitudes of the slips,

    min 1/2 u^T K u - F^T u + b^T s   with   y = (N u + gamma, s - T u, s + T u) >= 0.

Mehrotra's predictor and corrector [1]_ solves it whatever the signs of the entries of K. Each step factorises
``K + G^T diag(z / y) G``, which keeps its pattern: z >= 0 are the multipliers of ``y = G x + h``.

.. [1] S. Mehrotra, On the implementation of a primal-dual interior point method, SIAM J. Optim. 2 (1992)
   575-601.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.factorisation import factorised
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array


def interior_point(system: ContactSystem, start: Equilibrium) -> Iterator[tuple[ActiveSet, Array]]:
    """The active set and the contact forces (gaps,) after each step, which takes one factorisation.

    Nodes touch where the force is larger than the gap, in units of the stiffness there, and stick where both
    multipliers of a slip are. The sets end when products of forces and gaps are too small for a number.
    """
    bound, gaps = system.slip_bound, system.offset.size
    slides = np.flatnonzero(system.rotated.slips & (bound > 0)) if bound.size else np.zeros(0, np.int64)
    T, S, b = system.tangents[slides], sp.eye_array(slides.size), bound[slides]
    program = _BarrierProgram(
        H=sp.block_diag([system.stiffness, 0 * S], format="csc"),
        load=np.append(system.load, -b),
        G=sp.block_array([[system.normals, None], [-T, S], [T, S]], format="csr"),
        offset=np.append(system.offset, np.zeros(2 * b.size)),
    )
    slip, below, above = (values[slides] for values in system.friction(start))
    x, z = np.append(start.u, slip), np.abs(np.concatenate([start.normal_force, below, above]))
    y, unit = np.abs(program.G @ x + program.offset), abs(program.G) @ program.H.diagonal()
    inside = np.mean(y * np.sqrt(unit) + z / np.sqrt(unit))  # the same whatever the units of single unknowns
    y, z = y + inside / np.sqrt(unit), z + inside * np.sqrt(unit)
    while np.all(y * z > 0):
        try:
            x, y, z = program.step(x, y, z)
        except RuntimeError:  # singular: no gap prevents some rigid motion
            return
        touching, forward, backward = np.split(z > unit * y, [gaps, gaps + b.size])
        sliding = np.zeros(bound.size, dtype=np.int8)
        sliding[slides] = forward.astype(np.int8) - backward
        yield ActiveSet(touching, sliding), z[:gaps]


class _BarrierProgram(NamedTuple):
    """The program ``min 1/2 x^T H x - load^T x`` with ``G x + offset >= 0``."""

    H: sp.csc_array
    load: Array
    G: sp.csr_array
    offset: Array

    def step(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        """Unknowns, ``y = G x + offset`` and multipliers after a predictor and a corrector."""
        H, load, G, offset = self
        unbalanced, apart = H @ x - load - G.T @ z, G @ x + offset - y
        solve = factorised(sp.csc_array(H + G.T @ sp.diags_array(z / y) @ G))

        def newton(change: Array) -> tuple[Array, Array, Array]:
            """The step that changes the products y z, to first order."""
            dx = solve(G.T @ ((change - z * apart) / y) - unbalanced)
            dy = G @ dx + apart
            return dx, dy, (change - z * dy) / y

        def taken(dy: Array, dz: Array, most: float) -> float:
            """The part of a step, at most one, that goes ``most`` of the way to where y or z vanishes."""
            return most / max(most, np.max(-dy / y), np.max(-dz / z))

        _, dy, dz = newton(-y * z)
        part, mean = taken(dy, dz, 1.0), np.mean(y * z)
        centred = np.mean((y + part * dy) * (z + part * dz)) ** 3 / mean**2
        dx, dy, dz = newton(centred - dy * dz - y * z)
        part = taken(dy, dz, 0.995)
        return x + part * dx, y + part * dy, z + part * dz
