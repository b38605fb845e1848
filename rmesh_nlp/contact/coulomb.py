"""Contact with Coulomb friction on a fixed mesh by a semismooth Newton method, damped where it cycles.

With the bound ``b = g omega + F max(lambda - c gap, 0)`` and the slip v the laws of contact and friction are

    lambda = max(lambda - c gap, 0),    tau = proj_[-b, b](tau - c v)    for any c > 0.

Newton's method for them and the equilibrium guesses the nodes that touch and how they slide, and solves a
linear system for each guess [1]_. Full steps with c without limit, which the signs of gaps and forces decide,
take the fewest guesses. Nothing guarantees that they end. From the first guess that comes back steps are
damped so that the sum of squares of the residuals falls; the equilibrium, which is linear, goes on to hold.
Where no part of a step is a gain a full one is taken, a few times.

.. [1] K. Kunisch, G. Stadler, Generalized Newton methods for the 2D-Signorini contact problem with friction
   in function space, ESAIM M2AN 39 (2005) 827-854.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rmesh_nlp.contact.next_set import PATIENCE, holding, next_set
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.optimize.status import Status

PARTS = 0.5 ** np.arange(9)
"""Parts of a Newton step that are tried."""


def newton(system: ContactSystem, active: ActiveSet, max_iterations: int) -> Equilibrium:
    """Solve a system with Coulomb friction from an active set; CYCLED where no part of a step is a gain."""
    seen: set[bytes] = set()
    at, least, restarts = None, np.inf, 0
    for iteration in range(1, max_iterations + 1):
        state = replace(system.equilibrium(active), iterations=iteration)
        proposal, wrong = next_set(system, state, active)
        if wrong == 0:
            return state
        seen.add(active.key())
        if at is None:
            proposal = holding(system, active, state, proposal)
            if proposal.key() in seen:
                at = state
                least, proposal = laws(system, at)
        else:
            for part in PARTS:
                trial = between(at, state, part)
                residual, proposal = laws(system, trial)
                if residual < least:
                    break
            else:
                if restarts == PATIENCE:
                    return replace(state, status=Status.CYCLED)
                restarts, trial = restarts + 1, state
                residual, proposal = laws(system, state)
            at, least = trial, residual
        active = holding(system, active, state, proposal)
    return replace(state, status=Status.ITERATION_LIMIT)


def between(start: Equilibrium, end: Equilibrium, part: float) -> Equilibrium:
    """Displacement and forces a part of the way from ``start`` to ``end``: in equilibrium as well."""
    changed = {
        name: getattr(start, name) + part * (getattr(end, name) - getattr(start, name))
        for name in ("u", "normal_force", "tangential_force")
    }
    return replace(start, **changed)


def laws(system: ContactSystem, state: Equilibrium) -> tuple[float, ActiveSet]:
    """The laws of contact and friction as equations of displacement and forces, c the stiffness of a node.

    The sum of squares of their residuals over c, and the active set of the next linear system.
    """
    c = abs(system.normals) @ system.stiffness.diagonal()
    normal = state.normal_force - c * (system.normals @ state.u + system.offset)
    tangential = state.tangential_force - c * (system.tangents @ state.u)
    bound = system.bound(normal)
    pressure = state.normal_force - np.maximum(normal, 0.0)
    friction = state.tangential_force - np.clip(tangential, -bound, bound)
    touching, sticks = normal > 0, (np.abs(tangential) <= bound) & (bound > 0)
    sliding = np.where(sticks, 0, np.where(tangential > 0, -1, 1)).astype(np.int8)
    residual = float(np.sum((pressure**2 + np.where(system.rotated.slips, friction, 0.0) ** 2) / c))
    return residual, ActiveSet(touching, sliding)
