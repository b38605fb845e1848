"""How much of a prolonged map is taken: none that does not lower the energy of the mesh it is taken to."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.contact.penetration import penetration_work_of
from rmesh_nlp.evaluation import Array
from rmesh_nlp.programs.reduced import ReducedEnergy

HALVINGS = 4
"""Parts of a map that are tried: the whole, a half, a quarter, an eighth."""


def accepted(energy: ReducedEnergy, q: Array) -> tuple[Array, float]:
    """The moves that are taken, and the part of ``q`` that they are; 0 for the mesh as given.

    The largest part counts whose energy is below that of the mesh as given. Gaps hold at nodes only, so the
    energies are compared with what penetration between nodes is worth added to both: over a curved
    foundation a coarse map gains by pulling nodes apart, and such a gain does not last on a finer mesh.

    Parameters
    ----------
    energy : ReducedEnergy
        Of the mesh that the map was prolonged to.
    q : (n,) array
    """
    given = without_penetration(energy, np.zeros_like(q))
    part = 1.0
    for _ in range(HALVINGS):
        if energy.is_defined(part * q) and without_penetration(energy, part * q) < given:
            return part * q, part
        part /= 2
    return np.zeros_like(q), 0.0


def penetration_at(energy: ReducedEnergy, q: Array) -> float:
    """What penetration between contact nodes is worth at moves ``q``, in units of energy."""
    nodes = np.asarray(energy.relocation.nodes(q))
    return penetration_work_of(energy.model, nodes, energy(q).equilibrium)


def without_penetration(energy: ReducedEnergy, q: Array) -> float:
    """The energy if the gap held between the nodes as well, to first order."""
    return energy(q).equilibrium.energy + penetration_at(energy, q)
