"""How much of a prolonged map is taken: none that does not lower the energy of the mesh it is taken to."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.reduced import ReducedEnergy

HALVINGS = 4
"""Parts of a map that are tried: the whole, a half, a quarter, an eighth."""


def accepted(energy: ReducedEnergy, q: Array) -> tuple[Array, float]:
    """The moves that are taken, and the part of ``q`` that they are; 0 for the mesh as given.

    The largest part counts whose energy is below that of the mesh as given: the continuous energy
    (:mod:`rmesh_nlp.assessment.admissible`), since what a coarse map gains by errors of the discretisation
    does not last on a finer mesh.

    Parameters
    ----------
    energy : ReducedEnergy
        Of the mesh that the map was prolonged to.
    q : (n,) array
    """
    given = _continuous(energy, np.zeros_like(q))
    part = 1.0
    for _ in range(HALVINGS):
        if energy.is_defined(part * q) and _continuous(energy, part * q) < given:
            return part * q, part
        part /= 2
    return np.zeros_like(q), 0.0


def _continuous(energy: ReducedEnergy, q: Array) -> float:
    nodes = energy.relocation.nodes(q)
    return admissible(energy.relocation.problem, nodes, energy(q).equilibrium.active).energy
