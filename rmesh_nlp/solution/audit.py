"""The referee: what a mesh and a displacement are worth, measured on the source problem.

No number here comes from an optimiser. The optimiser exploits quadrature (nodes move to
where a low-order rule is wrong), so the energy is computed once more by a contact solve with
a rule of high degree on the final mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.contact.penetration import penetration, penetration_excess
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.discretisation.validity import least_area_ratio
from rmesh_nlp.evaluation import Array
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem

AUDIT_DEGREE = 20
"""Degree of the quadrature rule of the audit."""

TOLERANCE = 1e-6
"""Largest scaled residual of a solution that may be called a success."""


@dataclass(frozen=True)
class Audit:
    """Measured properties of a solution.

    Attributes
    ----------
    energy_audited : float
        Energy of the contact problem re-solved on the same mesh with a rule of degree 20.
    equilibrium_residual : float
        Largest out-of-balance nodal force, relative to the largest applied one.
    complementarity_residual : float
        Largest natural residual of contact and friction laws, see :func:`law_residual`.
    min_area_ratio : float
        Least signed element area over its initial one; not positive if inverted.
    penetration : float
        Deepest penetration between contact nodes, in units of length. The gap is imposed at
        nodes only; where the foundation is curved the optimiser may move nodes to where that
        hurts least, and this is by how much it cheated.
    penetration_excess : float
        The same as a part of what is allowed, see :mod:`rmesh_nlp.contact.penetration`.
    """

    energy_audited: float
    equilibrium_residual: float
    complementarity_residual: float
    min_area_ratio: float
    penetration: float = float("nan")
    penetration_excess: float = float("nan")


class Auditor:
    """Audits solutions of one problem; the accurate contact model is built once."""

    def __init__(self, problem: ContactProblem, model: ContactModel) -> None:
        self.problem, self.model = problem, model
        self.accurate = model.with_rule(AUDIT_DEGREE)
        self.accurate_problem = self.accurate.problem

    def solve(self, nodes: Array, start: ActiveSet | None = None) -> Equilibrium:
        """Contact solution by the rule of the audit at node positions (2, nodes).

        ``start`` is the active set by the rule of the problem, with which it begins; what it does not solve
        from there is solved from a guess of its own.
        """
        found = self.accurate.solve(nodes, start)
        return found if found.status is Status.CONVERGED or start is None else self.accurate.solve(nodes)

    def __call__(self, nodes: Array, found: Equilibrium, accurate: Equilibrium) -> Audit:
        """Audit a contact solution on a mesh; ``accurate`` is that of :meth:`solve`."""
        u, normal_force, tangential_force = found.u, found.normal_force, found.tangential_force
        system = self.model.system(nodes)
        displacement = self.model.displacement.values(u)
        return Audit(
            energy_audited=accurate.energy,
            equilibrium_residual=equilibrium_residual(system, u, normal_force, tangential_force),
            complementarity_residual=law_residual(system, u, normal_force, tangential_force),
            min_area_ratio=least_area_ratio(self.problem, nodes),
            penetration=penetration(self.problem, nodes, displacement),
            penetration_excess=penetration_excess(self.problem, nodes, displacement),
        )


def equilibrium_residual(system: ContactSystem, u: Array, normal: Array, tangential: Array) -> float:
    """``max |K u - F - N^T lambda - T^T tau|`` over the largest applied nodal force."""
    residual = system.stiffness @ u - system.load - system.normals.T @ normal
    if system.slip_bound.size:
        residual = residual - system.tangents.T @ tangential
    return float(np.max(np.abs(residual)) / system.force_scale)


def law_residual(system: ContactSystem, u: Array, normal: Array, tangential: Array) -> float:
    """Violation of the contact and friction laws (3.10) at the nodes, dimensionless.

    ``max |min(gap / U, lambda / F)|`` and ``max |tau + proj(slip F / U - tau)| / F``, the
    projection on [-b, b]; U the largest displacement and F the largest applied nodal force.
    Both vanish exactly where the laws hold, and count penetration and tension as well.
    """
    length = max(float(np.max(np.abs(u), initial=0.0)), 1e-300)
    force = system.force_scale
    gap = system.normals @ u + system.offset
    worst = float(np.max(np.abs(np.minimum(gap / length, normal / force)), initial=0.0))
    if system.slip_bound.size:
        slip = (system.tangents @ u) * force / length
        friction = tangential + np.clip(slip - tangential, -system.slip_bound, system.slip_bound)
        worst = max(worst, float(np.max(np.abs(friction), initial=0.0)) / force)
    return worst
