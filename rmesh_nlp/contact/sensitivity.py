"""How a contact solution changes with its data, the active set held."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import Array, Mask, magnitude
from rmesh_nlp.optimize.activity import both_vanish


class TangentResponse:
    """First-order change of displacement and contact forces with the active set held.

    ``held`` numbers the displacements, as :class:`~rmesh_nlp.contact.system.RotatedSystem` has them, that
    touching and sticking nodes hold.
    """

    def __init__(self, system: ContactSystem, active: ActiveSet) -> None:
        rotated = self._rotated = system.rotated
        self._inside, self._solve = rotated.factor(active)
        self._touching, self._sticking = active.touching, rotated.sticking(active)
        self.held = np.concatenate([rotated.normal[self._touching], rotated.tangent[self._sticking]])
        # the columns of held unknowns carry the change of gaps and slips, their rows the change of the forces
        self._columns = sp.csr_array(rotated.K[:, self.held])
        self._held_rows = sp.csr_array(rotated.K.T[self.held])

    def held_by(self, gap: sp.sparray, slip: sp.sparray) -> sp.sparray:
        """Rows of gaps and slips (contact nodes, n) that hold a displacement, in the order of ``held``."""
        return sp.vstack([sp.csr_array(gap)[self._touching], sp.csr_array(slip)[self._sticking]])

    def __call__(self, force: Array, gap: Array, slip: Array) -> tuple[Array, Array, Array]:
        """Changes of ``u``, of normal and of tangential forces; zero at nodes that do not touch or stick.

        They follow from the changes at fixed displacement of the out-of-balance ``force`` K u - F, (m,) or
        (m, k), and of ``gap`` and ``slip``, (contact nodes,) or (contact nodes, k).
        """
        rotated, held, inside = self._rotated, self.held, self._inside
        turned = rotated.turned(force)
        w = np.zeros(turned.shape)
        w[held] = -np.concatenate([gap[self._touching], slip[self._sticking]])
        w[inside] = self._solve(-(turned + self._columns @ w[held])[inside])
        change = self._held_rows @ w + turned[held]
        normal, tangential = np.zeros((2, *gap.shape))
        normal[self._touching], tangential[self._sticking] = np.split(change, [int(self._touching.sum())])
        return rotated.back(w), normal, tangential


def weakly_active(system: ContactSystem, state: Equilibrium) -> Mask:
    """Contact nodes where strict complementarity fails: there u(X) has one-sided derivatives only.

    Gap and normal force both vanish, or slip vanishes while the friction is at its bound.
    """
    force = system.force_scale
    length = max(magnitude(state.u), 1e-300)
    gap = system.normals @ state.u + system.offset
    weak = both_vanish(gap / length, state.normal_force / force)
    if system.slip_bound.size:
        slip = system.tangents @ state.u
        reserve = system.bound(state.normal_force) - np.abs(state.tangential_force)
        acts = True if system.frictional is None else system.frictional
        weak |= acts & both_vanish(slip / length, reserve / force)
    return weak
