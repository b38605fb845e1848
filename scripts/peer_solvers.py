"""What people would use in place of the formulations on Example 6.1: plain CasADi, and SciPy."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.optimize import Bounds, minimize

import rmesh_nlp as rm
from formulations import joint
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.fields import Field
from rmesh_nlp.models.energy_nlp import relocation
from rmesh_nlp.models.reduced_model import ReducedEnergy
from rmesh_nlp.optimize.solver import IPOPT_OPTIONS, Solver
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.solution import Solution

TOLERANCE = 1e-8
"""Of SciPy's solvers."""


@dataclass(frozen=True)
class Case:
    """A relocation problem, what is minimised, and the seconds a solver may take."""

    problem: ContactProblem
    objective: str = "energy"
    limit: float = float("inf")

    def solve(self, formulation: str, **settings: object) -> Finish:
        """By one of our formulations; the assessment is no part of its time."""
        began = time.process_time()
        limits = rm.Limits(min(self.limit, 1e6))
        solution = rm.solve(self.problem, formulation, objective=self.objective, limits=limits, **settings)
        status = solution.status.value if solution.success else f"{solution.status.value}, no success"
        value = None if self.objective == "energy" else float(solution.record()["objective_value"])
        seconds = unassessed(time.process_time() - began, solution)
        return Finish(np.asarray(solution.mesh.p), status, seconds, solution.iterations, value)


@dataclass(frozen=True)
class Finish:
    """Positions (2, nodes), the solver's own word, processor seconds of build and solve, and counts.

    ``value`` is the objective, where that is not the energy.
    """

    nodes: Array
    status: str
    seconds: float
    iterations: int | None = None
    value: float | None = None


def unassessed(seconds: float, solution: Solution) -> float:
    """Seconds of a solve without the share of its assessment."""
    record = solution.record()
    return seconds * (1 - record["audit_time_s"] / record["wall_time_s"])


@dataclass(frozen=True, eq=False)
class Program:
    """The energy NLP of ``joint`` on Example 6.1 as numbers, to be written in any modelling language.

    Unknowns ``x = (q, u)``; ``positions`` and ``displacement`` say how nodal values follow from them.
    """

    positions: Field
    displacement: Field
    triangles: Array
    contact: Array
    bound: Array
    start: Array
    unit: float

    def ipopt(self, limit: float) -> dict[str, Any]:
        """What ``joint`` gives Ipopt, and so every peer that uses Ipopt on the same program."""
        own = joint.Joint().options(areas=False, unit=self.unit)
        return {**IPOPT_OPTIONS, **own, "max_wall_time": min(limit, 1e6)}


def program_of(problem: ContactProblem) -> Program:
    """The program of Example 6.1 and the start of ``joint``."""
    outer = Outer.of(problem)
    rel = outer.relocation
    if rel.n_valid or rel.n_s:
        raise ValueError("only for move limits that exclude inverted elements, and without friction")
    return Program(
        positions=rel.mesh_map.positions,
        displacement=rel.displacement,
        triangles=problem.triangles.T,
        contact=problem.contact_nodes,
        bound=rel.nlp.ubx,
        start=outer.energy.point(np.zeros(rel.n_q), outer.given),
        unit=joint.pull(outer.energy(np.zeros(rel.n_q)).gradient),
    )


def nlpsol_mapped(case: Case) -> Finish:
    """Our expressions, all derivatives left to ``nlpsol``."""
    program = program_of(case.problem)
    began = time.process_time()
    rel = relocation(case.problem)
    plain = replace(rel.nlp, derivatives=None)
    result = Solver(plain, options=program.ipopt(case.limit))(program.start)
    seconds = time.process_time() - began
    return Finish(rel.nodes(rel.split(result.x)[0]), result.status.value, seconds)


def nlpsol_written_out(case: Case) -> Finish:
    """What one writes first in CasADi: a sum over the elements, handed to ``nlpsol``."""
    program = program_of(case.problem)
    began = time.process_time()
    x = ca.SX.sym("x", program.start.size)
    energy, u = energy_61(program, ca.vertsplit(x))
    gaps = ca.vertcat(*[u[i] for i in program.contact])
    settings = {"ipopt": program.ipopt(case.limit), "print_time": False, "error_on_fail": False}
    solver = ca.nlpsol("solver", "ipopt", {"x": x, "f": energy, "g": gaps}, settings)
    answer = solver(x0=program.start, lbx=-program.bound, ubx=program.bound, lbg=0, ubg=np.inf)
    seconds = time.process_time() - began
    status = "converged" if solver.stats()["success"] else solver.stats()["return_status"]
    end = np.clip(answer["x"].full().ravel(), -program.bound, program.bound)
    return Finish(program.positions.values(end), status, seconds)


def energy_61(program: Program, x: Any) -> tuple[Any, list[Any]]:
    """The energy of Example 6.1, element by element with the midpoint rule, and the nodal displacements."""
    X, Y = (entries(program.positions, i, x) for i in (0, 1))
    u = entries(program.displacement, 0, x)
    terms = []
    for a, b, c in program.triangles.tolist():
        x1, x2, y1, y2 = X[b] - X[a], X[c] - X[a], Y[b] - Y[a], Y[c] - Y[a]
        det, u1, u2 = x1 * y2 - x2 * y1, u[b] - u[a], u[c] - u[a]
        strain = ((y2 * u1 - y1 * u2) ** 2 + (x1 * u2 - x2 * u1) ** 2) / (4 * det)
        work = sum(
            source_61((X[i] + X[j]) / 2, (Y[i] + Y[j]) / 2, ca.sin, ca.if_else) * (u[i] + u[j]) / 2
            for i, j in ((a, b), (b, c), (c, a))
        )
        terms.append(strain - det / 6 * work)
    return sum(terms), u


def entries(field: Field, component: int, x: Any) -> list[Any]:
    """Nodal values as expressions of the unknowns ``x[i]``, plain numbers where they are fixed."""
    index, scale, offset = (a[component].tolist() for a in (field.index, field.scale, field.offset))
    return [
        o if i < 0 else o + s * x[i] if o else s * x[i] for i, s, o in zip(index, scale, offset, strict=True)
    ]


def source_61(x: Any, y: Any, sin: Callable[[Any], Any], choose: Callable[[Any, Any, Any], Any]) -> Any:
    """-Laplace of the exact solution (6.2), differentiated by hand; by numpy or CasADi."""
    a, pi = 0.5 - y, np.pi
    lower = 200 * sin(2 * pi * x) * (4 * pi**2 * y * a**4 + 8 * a**3 - 12 * y * a**2)
    upper = 100 * sin(pi / 2 * x) * (pi**2 / 4 * (1 - y) * a**4 - 8 * a**3 - 12 * (1 - y) * a**2)
    return choose(y <= 0.5, lower, upper)


class OutOfTimeError(Exception):
    """Raised inside a solver of SciPy to end it."""


def scipy_minimize(method: str) -> Callable[[Case], Finish]:
    """``scipy.optimize.minimize`` on the reduced energy with our gradient: a contact solve per evaluation."""

    def run(case: Case) -> Finish:
        began = time.process_time()
        reduced = ReducedEnergy.of(ContactSolver(case.problem))
        bound = reduced.relocation.mesh_map.upper
        best, lowest = np.zeros(bound.size), np.inf
        unit = abs(reduced(best).value) or 1.0

        def objective(q: Array) -> float:
            nonlocal best, lowest
            if time.process_time() - began > case.limit:
                raise OutOfTimeError
            found = reduced(q).value
            if found < lowest:
                best, lowest = q.copy(), found
            return found / unit

        how = {"jac": lambda q: reduced(q).gradient / unit, "bounds": Bounds(-bound, bound), "tol": TOLERANCE}
        try:
            result = minimize(objective, best, method=method, options={"maxiter": 500}, **how)
            q, status = result.x, "converged" if result.success else str(result.message)
        except OutOfTimeError:
            q, status = best, f"stopped after {case.limit:g} s"
        seconds = time.process_time() - began
        return Finish(reduced.relocation.nodes(np.clip(q, -bound, bound)), status, seconds)

    return run
