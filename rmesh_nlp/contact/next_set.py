"""Which active set a contact solution for another one asks for: the step of the methods that look for it."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.evaluation import ROUNDING, Array, Mask, magnitude

PATIENCE = 3
"""Full steps without progress: those that leave more than half of the wrong signs, until the interior-point
method takes over, and with Coulomb friction those of which no part is a gain. Of 392 systems with
coefficients up to 10 Newton's method fails for 4 with 3, 4 or 8 such steps, for 16 with none."""


def next_set(system: ContactSystem, state: Equilibrium, active: ActiveSet) -> tuple[ActiveSet, int]:
    """The active set that the signs of gaps and forces ask for, and how many signs are wrong."""
    # rounding of the linear solve must not make a node that just touches flicker
    small_force = 1e-13 * max(system.force_scale, magnitude(state.normal_force))
    small_gap = 1e-13 * max(magnitude(state.u), 1e-300)
    gap = system.normals @ state.u + system.offset
    touching = np.where(active.touching, state.normal_force >= -small_force, gap < -small_gap)
    slip, force = system.tangents @ state.u, state.tangential_force
    onset = np.where(np.abs(force) > system.bound(state.normal_force) + small_force, -np.sign(force), 0)
    stays = active.sliding * slip >= -small_gap
    sliding = np.where(active.sliding == 0, onset, np.where(stays, active.sliding, 0)).astype(np.int8)
    if system.coulomb is not None:  # nothing holds an open node, whichever way it slides
        free = ~(active.touching & touching) & (system.slip_bound == 0)
        # a node that meets the foundation sticks if the overlap presses enough for its slip
        sticks = touching & (np.abs(slip) <= -system.coulomb * gap)
        way = np.where(sticks, 0, np.where(slip < 0, -1, 1))
        sliding = np.where(free, way, sliding).astype(np.int8)
        counts = active.touching | touching | ~free | (active.sliding == 0)
        sliding = np.where(counts, sliding, active.sliding).astype(np.int8)
    wrong = np.sum(touching != active.touching) + np.sum(sliding != active.sliding)
    return ActiveSet(touching, sliding), int(wrong)


def holding(system: ContactSystem, before: ActiveSet, state: Equilibrium, proposal: ActiveSet) -> ActiveSet:
    """The proposal, with as many nodes of the last set, by force, kept in touch as hold the body."""
    if system.rigid is None:
        return proposal
    gaps = system.normals @ system.rigid
    touching = proposal.touching.copy()
    leaving = np.flatnonzero(before.touching & ~touching)
    for node in leaving[np.argsort(-state.normal_force[leaving], kind="stable")]:
        held = rank(gaps, touching)
        if held == system.rigid.shape[1]:
            break
        touching[node] = True
        if rank(gaps, touching) == held:
            touching[node] = False
    return ActiveSet(touching, proposal.sliding)


def rank(gaps: Array, rows: Mask) -> int:
    """Rank of the chosen rows of the gaps of rigid motions (gaps, motions)."""
    return int(np.linalg.matrix_rank(gaps[rows], tol=ROUNDING))
