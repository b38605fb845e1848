"""What people would use in place of the formulations on Example 6.1: plain CasADi, and SciPy."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import Bounds, minimize

from best_mesh.cases import source_61
from formulations import joint
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.optimize.solver import IPOPT_OPTIONS, Solver
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer
from rows import timed

TOLERANCE = 1e-8
"""Of SciPy's solvers."""


@dataclass(frozen=True)
class End:
    """Positions (2, nodes), the solver's own word, processor seconds of build and solve, and counts.

    ``value`` is the objective, where that is not the energy.
    """

    nodes: Array
    status: str
    seconds: float
    iterations: int | None = None
    value: float | None = None


def start_of_joint(problem: ContactProblem, limit: float) -> tuple[Array, dict[str, Any]]:
    """Where ``joint`` starts, ``x = (q, u)``, and what it gives Ipopt: so every peer that uses it."""
    outer = Outer.of(problem)
    if outer.relocation.n_valid or outer.relocation.n_s:
        raise ValueError("only for move limits that exclude inverted elements, and without friction")
    q = np.zeros(outer.relocation.n_q)
    unit = joint.pull(outer.energy(q).gradient)
    options = {**IPOPT_OPTIONS, **joint.Joint().options(areas=False, unit=unit), "max_wall_time": limit}
    return outer.energy.point(q, outer.given), options


def nlpsol_mapped(problem: ContactProblem, objective: str, limit: float) -> End:
    """Our expressions, all derivatives left to ``nlpsol``."""
    start, options = start_of_joint(problem, limit)

    def work() -> tuple[Array, str]:
        rel = relocation(problem)
        result = Solver(replace(rel.nlp, derivatives=None), options=options)(start)
        return rel.nodes(rel.split(result.x)[0]), result.status.value

    (nodes, status), seconds = timed(work)
    return End(nodes, status, seconds)


def nlpsol_written_out(problem: ContactProblem, objective: str, limit: float) -> End:
    """What one writes first in CasADi: a sum over the elements, handed to ``nlpsol``."""
    start, options = start_of_joint(problem, limit)
    rel = Outer.of(problem).relocation
    bound, positions = rel.nlp.ubx, rel.mesh_map.positions

    def work() -> tuple[Array, str]:
        x = ca.SX.sym("x", start.size)
        unknowns = ca.vertsplit(x)
        u = entries(rel.displacement, 0, unknowns)
        energy = energy_61(problem, *(entries(positions, i, unknowns) for i in (0, 1)), u)
        gaps = ca.vertcat(*[u[i] for i in problem.contact_nodes])
        settings = {"ipopt": options, "print_time": False, "error_on_fail": False}
        solver = ca.nlpsol("solver", "ipopt", {"x": x, "f": energy, "g": gaps}, settings)
        answer = solver(x0=start, lbx=-bound, ubx=bound, lbg=0, ubg=np.inf)
        status = "converged" if solver.stats()["success"] else solver.stats()["return_status"]
        return positions.values(np.clip(answer["x"].full().ravel(), -bound, bound)), status

    (nodes, status), seconds = timed(work)
    return End(nodes, status, seconds)


def energy_61(problem: ContactProblem, x: list[Any], y: list[Any], u: list[Any]) -> Any:
    """The energy of Example 6.1, element by element with the midpoint rule, of nodal positions and values."""
    terms = []
    for a, b, c in problem.triangles.T.tolist():
        x1, x2, y1, y2 = x[b] - x[a], x[c] - x[a], y[b] - y[a], y[c] - y[a]
        det, u1, u2 = x1 * y2 - x2 * y1, u[b] - u[a], u[c] - u[a]
        strain = ((y2 * u1 - y1 * u2) ** 2 + (x1 * u2 - x2 * u1) ** 2) / (4 * det)
        work = sum(
            source_61((x[i] + x[j]) / 2, (y[i] + y[j]) / 2, ca.sin, ca.if_else) * (u[i] + u[j]) / 2
            for i, j in ((a, b), (b, c), (c, a))
        )
        terms.append(strain - det / 6 * work)
    return sum(terms)


def entries(field: Field, component: int, x: Any) -> list[Any]:
    """Nodal values as expressions of the unknowns ``x[i]``, plain numbers where they are fixed."""
    index, scale, offset = (a[component].tolist() for a in (field.index, field.scale, field.offset))
    return [
        o if i < 0 else o + s * x[i] if o else s * x[i] for i, s, o in zip(index, scale, offset, strict=True)
    ]


def scipy_minimize(problem: ContactProblem, objective: str, limit: float, method: str) -> End:
    """``scipy.optimize.minimize`` on the reduced energy with our gradient: a contact solve per evaluation."""
    began = time.process_time()
    reduced = ReducedEnergy.of(ContactSolver(problem))
    bound = reduced.relocation.mesh_map.upper
    best, lowest = np.zeros(bound.size), np.inf
    unit = abs(reduced(best).value) or 1.0

    def energy(q: Array) -> float:
        nonlocal best, lowest
        if time.process_time() - began > limit:
            raise TimeoutError
        value = reduced(q).value
        if value < lowest:
            best, lowest = q.copy(), value
        return value / unit

    how = {"jac": lambda q: reduced(q).gradient / unit, "bounds": Bounds(-bound, bound), "tol": TOLERANCE}
    try:
        result = minimize(energy, best, method=method, options={"maxiter": 500}, **how)
        q, status = result.x, "converged" if result.success else str(result.message)
    except TimeoutError:
        q, status = best, f"stopped after {limit:g} s"
    seconds = time.process_time() - began
    return End(reduced.relocation.nodes(np.clip(q, -bound, bound)), status, seconds)
