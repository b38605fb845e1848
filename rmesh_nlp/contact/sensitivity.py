"""How a contact solution changes with its data, the active set held."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array


def adjoint(system: ContactSystem, active: ActiveSet, right: Array) -> tuple[Array, Array]:
    """Adjoint of the contact solution with its active set held.

    Solves ``K p = right`` over the displacements that the active set leaves free, p = 0 in
    the normal direction of touching and in the tangential direction of sticking nodes.

    Returns
    -------
    p : (m,) array
    reaction : (contact nodes,) array
        ``right - K p`` in the normal direction of touching nodes, zero at the others.
    """
    rotated = system.rotated
    turned = right if rotated.basis is None else rotated.basis.T @ right
    inside, factor = rotated.factor(active)
    p = np.zeros(turned.size)
    p[inside] = factor.solve(turned[inside])
    reaction = np.where(active.touching, (turned - rotated.K @ p)[rotated.normal], 0.0)
    return p if rotated.basis is None else rotated.basis @ p, reaction


def tangent_response(
    system: ContactSystem, active: ActiveSet
) -> Callable[[Array, Array], tuple[Array, Array]]:
    """First-order change of displacement and normal force with the active set held.

    The returned function takes the change of the out-of-balance force ``K u - F`` at fixed
    displacement and the change of the gaps, and gives those of ``u`` and ``lambda``.
    """
    rotated = system.rotated
    inside, factor = rotated.factor(active)
    touching = rotated.normal[active.touching]
    # the columns of touching nodes carry the change of the gaps, their rows the change of the forces
    columns = sp.csr_array(rotated.K[:, touching])
    rows = sp.csr_array(rotated.K.T[touching])

    def respond(force: Array, gap: Array) -> tuple[Array, Array]:
        turned = force if rotated.basis is None else rotated.basis.T @ force
        w = np.zeros(turned.size)
        w[touching] = -gap[active.touching]
        w[inside] = factor.solve(-(turned + columns @ w[touching])[inside])
        change = np.zeros(gap.size)
        change[active.touching] = rows @ w + turned[touching]
        return (w if rotated.basis is None else rotated.basis @ w), change

    return respond


def weakly_active(system: ContactSystem, state: Equilibrium, tolerance: float = 1e-6) -> NDArray[np.bool_]:
    """Contact nodes where strict complementarity fails, in scaled units.

    Gap and normal force both vanish, or slip vanishes while the friction is at its bound.
    There u(X) has only one-sided derivatives.
    """
    force = system.force_scale
    length = max(float(np.max(np.abs(state.u), initial=0.0)), 1e-300)
    gap = system.normals @ state.u + system.offset
    weak = np.maximum(np.abs(gap) / length, np.abs(state.normal_force) / force) < tolerance
    if system.slip_bound.size:
        slip = np.abs(system.tangents @ state.u) / length
        reserve = np.abs(system.slip_bound - np.abs(state.tangential_force)) / force
        acts = True if system.frictional is None else system.frictional
        weak |= acts & (np.maximum(slip, reserve) < tolerance)
    return np.asarray(weak)
