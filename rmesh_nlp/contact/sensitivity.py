"""How a contact solution changes with its data, the active set held."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.activity import both_vanish


def adjoint(system: ContactSystem, active: ActiveSet, right: Array) -> tuple[Array, Array, Array]:
    """Adjoint of the contact solution with its active set held.

    Solves ``K p = right`` over the displacements that the active set leaves free, p = 0 in
    the normal direction of touching and in the tangential direction of sticking nodes.

    Returns
    -------
    p : (m,) array
    reaction : (contact nodes,) array
        ``right - K p`` in the normal direction of touching nodes, zero at the others.
    friction : (contact nodes,) array
        The same in the tangential direction of sticking nodes.
    """
    rotated = system.rotated
    turned = right if rotated.basis is None else rotated.basis.T @ right
    inside, factor = rotated.factor(active)
    p = np.zeros(turned.size)
    p[inside] = factor.solve(turned[inside])
    left = turned - rotated.K @ p
    reaction = np.where(active.touching, left[rotated.normal], 0.0)
    friction = np.where(_sticking(system, active), left[rotated.tangent], 0.0)
    return p if rotated.basis is None else rotated.basis @ p, reaction, friction


def _sticking(system: ContactSystem, active: ActiveSet) -> NDArray[np.bool_]:
    """Nodes whose slip the active set holds."""
    if not system.slip_bound.size:
        return np.zeros(active.touching.size, dtype=bool)
    return system.rotated.slips & (active.sliding == 0)


def tangent_response(
    system: ContactSystem, active: ActiveSet
) -> Callable[[Array, Array, Array], tuple[Array, Array, Array]]:
    """First-order change of displacement and contact forces with the active set held.

    The returned function takes the changes of the out-of-balance force ``K u - F``, of the gaps and of the
    slips, all at fixed displacement, and gives those of ``u``, of the normal forces, and of the tangential
    forces of sticking nodes (zero at the others). Given matrices it does so column by column.
    """
    rotated = system.rotated
    inside, factor = rotated.factor(active)
    sticking, n_touching = _sticking(system, active), int(active.touching.sum())
    held = np.concatenate([rotated.normal[active.touching], rotated.tangent[sticking]])
    # the columns of held unknowns carry the change of gaps and slips, their rows the change of the forces
    columns = sp.csr_array(rotated.K[:, held])
    rows = sp.csr_array(rotated.K.T[held])

    def respond(force: Array, gap: Array, slip: Array) -> tuple[Array, Array, Array]:
        turned = force if rotated.basis is None else rotated.basis.T @ force
        w = np.zeros(turned.shape)
        w[held] = -np.concatenate([gap[active.touching], slip[sticking]])
        w[inside] = factor.solve(-(turned + columns @ w[held])[inside])
        change = rows @ w + turned[held]
        normal, tangential = np.zeros((2, *gap.shape))
        normal[active.touching], tangential[sticking] = np.split(change, [n_touching])
        return (w if rotated.basis is None else rotated.basis @ w), normal, tangential

    return respond


def weakly_active(system: ContactSystem, state: Equilibrium) -> NDArray[np.bool_]:
    """Contact nodes where strict complementarity fails, in scaled units.

    Gap and normal force both vanish, or slip vanishes while the friction is at its bound.
    There u(X) has only one-sided derivatives.
    """
    force = system.force_scale
    length = max(float(np.max(np.abs(state.u), initial=0.0)), 1e-300)
    gap = system.normals @ state.u + system.offset
    weak = both_vanish(gap / length, state.normal_force / force)
    if system.slip_bound.size:
        slip = system.tangents @ state.u
        reserve = system.slip_bound - np.abs(state.tangential_force)
        acts = True if system.frictional is None else system.frictional
        weak |= acts & both_vanish(slip / length, reserve / force)
    return np.asarray(weak)
