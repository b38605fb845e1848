"""Bodies that contact holds, and not the given displacements alone: when they have one equilibrium.

Let Z be the rigid motions left, f the work of the load in them and A the change of the gaps. An
equilibrium exists if every motion that opens no gap into the foundation, ``A r >= 0``, is one that the
load resists, ``f . r < 0``. It is unique if the nodes that press on the foundation prevent every
motion: two solutions differ by a rigid motion that leaves those gaps closed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.errors import ProblemError
from rmesh_nlp.evaluation import Array

RANK = 1e-9
"""Singular values below this part of the largest are zero."""


def check_load(system: ContactSystem) -> None:
    """Raise a ProblemError unless the load presses the body on its foundations.

    Raises
    ------
    ProblemError
        If some rigid motion away from all foundations does not cost energy.
    """
    if system.rigid is None:
        return
    work, gaps = system.rigid.T @ system.load, system.normals @ system.rigid
    scale = max(float(np.max(np.abs(work))), 1e-12 * system.force_scale)
    work = work / scale
    n = work.size
    for sign, k in ((s, k) for k in range(n) for s in (1.0, -1.0)):
        goal = np.zeros(n)
        goal[k] = -sign
        rows, right = np.vstack([-gaps, -work[None, :]]), np.zeros(len(gaps) + 1)
        answer = linprog(goal, rows, right, bounds=[(-1, 1)] * n)
        if answer.status == 0 and -answer.fun > 1e-6:
            raise ProblemError(
                "dirichlet",
                "the body can move off its foundations as a rigid body, and the load does not press it on "
                "them: give displacements that hold it, or turn the load",
            )


def check_unique(system: ContactSystem, state: Equilibrium) -> None:
    """Raise a ProblemError if the nodes that press on the foundation leave a rigid motion.

    Raises
    ------
    ProblemError
    """
    if system.rigid is None:
        return
    length = np.max(np.abs(system.offset), initial=0.0) + np.max(np.abs(state.u), initial=0.0)
    rounding = 1e-12 * length * np.max(system.stiffness.diagonal(), initial=0.0)
    pressing = state.normal_force > max(1e-9 * np.max(state.normal_force, initial=0.0), rounding)
    if _rank(system.normals @ system.rigid, pressing) < system.rigid.shape[1]:
        raise ProblemError(
            "dirichlet",
            "contact holds the body, but not in one place: it can still slide or turn on the nodes that "
            "press on the foundation; give one more displacement",
        )


def holding(system: ContactSystem, before: ActiveSet, state: Equilibrium, proposal: ActiveSet) -> ActiveSet:
    """The proposal, with as many nodes of the last set kept in touch as hold the body.

    Those with the largest force first.
    """
    if system.rigid is None:
        return proposal
    gaps = system.normals @ system.rigid
    touching = proposal.touching.copy()
    leaving = np.flatnonzero(before.touching & ~touching)
    for node in leaving[np.argsort(-state.normal_force[leaving], kind="stable")]:
        rank = _rank(gaps, touching)
        if rank == system.rigid.shape[1]:
            break
        touching[node] = True
        if _rank(gaps, touching) == rank:
            touching[node] = False
    return ActiveSet(touching, proposal.sliding)


def _rank(gaps: Array, rows: NDArray[np.bool_]) -> int:
    return int(np.linalg.matrix_rank(gaps[rows], tol=RANK)) if np.any(rows) else 0
