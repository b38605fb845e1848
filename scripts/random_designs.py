"""Design problems of random kind, seeded: for tests and benchmarks.

Bodies on foundations of several shapes, with or without friction, membranes over obstacles; numbers of laws,
loads, foundations and friction, amplitudes of shapes and often node positions vary. Targets and bounds of
constraints come from what the contact solution is at a random design, so that this one is feasible.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.meshes import named

LENGTH = 2.0
"""Of the body; its height is 1."""

YOUNG, LOAD = 1000.0, 10.0

FEWEST = 3
"""Design variables that a problem has at least; shapes are added until it does."""

RELAXED = 0.02
"""Part of a bound by which it is wider than the value at the feasible design."""

FRICTIONS = ("none", "tresca", "coulomb", "coulomb")


@dataclass(frozen=True)
class RandomDesign:
    """A problem, what is minimised, and a design (name -> value) at which all constraints hold."""

    problem: rm.ContactProblem
    objective: str
    feasible: dict[str, float]


@dataclass
class _Draw:
    """Numbers that are drawn, about half of them as design variables."""

    rng: np.random.Generator
    variables: list[rm.DesignVariable | rm.Shape] = field(default_factory=list)

    def number(self, name: str, low: float, high: float) -> Any:
        """A number within bounds: the symbol of a design variable, or a value."""
        value = float(self.rng.uniform(low, high))
        if self.rng.random() < 0.5:
            return value
        self.variables.append(rm.DesignVariable(name, value, (low, high)))
        return self.variables[-1].symbol

    def one_of(self, options: Sequence[Any]) -> Any:
        """An option."""
        return options[int(self.rng.integers(len(options)))]

    def shapes(self, boundary: str, count: int) -> None:
        """Amplitudes of sines on the boundary below or above."""
        for k in range(1, count + 1):
            size = 0.03 / k
            wave = lambda x, y, k=k: ca.sin(k * np.pi * x / LENGTH)  # noqa: E731
            self.variables.append(rm.Shape(f"{boundary}{k}", boundary, (0.0, wave), (-size, size)))


def random_design(seed: int) -> RandomDesign:
    """A design problem of random kind with 3 to 200 outer variables."""
    rng = np.random.default_rng(seed)
    while True:
        draw = _Draw(rng)
        try:
            problem = _membrane(draw) if rng.random() < 0.2 else _body(draw)
            result = _stated(draw, _designed(draw, problem))
        except rm.ProblemError:  # the foundation cuts a support at the first or at the feasible design
            continue
        if result is not None:
            return result


def _mesh(draw: _Draw) -> MeshTri:
    """A rectangle, perhaps with a bumpy bottom and two regions."""
    nx, ny = (int(draw.rng.integers(*range_)) for range_ in ((6, 17), (3, 7)))
    mesh = rm.shapes.rectangle(nx, ny, x=(0, LENGTH), diagonal=draw.one_of(["rising", "falling"]))
    if draw.rng.random() < 0.5:
        mesh = named(mesh, subdomains={"a": lambda x: x[1] < 0.5, "b": lambda x: x[1] >= 0.5})
    if draw.rng.random() < 0.3:
        x, y = mesh.p
        bumps = 0.01 * np.sin(draw.rng.integers(2, 5) * np.pi * x / LENGTH) * (1 - y)
        mesh = replace(mesh, doflocs=np.array([x, y + bumps]))
    return mesh


def _by_region(mesh: MeshTri, law: Callable[[str], Any]) -> Any:
    """A law by the name of its region, for each region or all of the mesh."""
    return {name: law(name) for name in ("a", "b")} if mesh.subdomains else law("")


def _body(draw: _Draw) -> rm.ContactProblem:
    mesh, law = _mesh(draw), draw.one_of([rm.PlaneStrain, rm.PlaneStress])
    weight = (0.0, -LOAD * draw.number("weight", 0.0, 1.0))
    laws = _by_region(
        mesh,
        lambda name: law.from_young(
            YOUNG * draw.number(f"E{name}", 0.5, 2.0), draw.number(f"nu{name}", 0.1, 0.4), weight
        ),
    )
    push, pull = LOAD * draw.number("push", 0.5, 2.0), LOAD * draw.number("pull", -1.0, 1.0)
    held = draw.one_of(["left", "top", "both"])
    top = rm.Dirichlet("top", (0.0, -float(draw.rng.uniform(0.005, 0.03))))
    slope = pull, lambda x, y: -push * (1 + x)
    supports, loads = {
        "left": (("left",), (rm.Traction("top", slope), rm.Traction("right", (pull, 0.0)))),
        "top": ((top,), (rm.Traction("right", (-push, pull)),)),
        "both": (("left", "right"), (rm.Traction("top", (pull, -10 * push)),)),
    }[held]
    friction = draw.one_of(FRICTIONS)
    bounds = {
        "none": {},
        "tresca": {"friction": LOAD * draw.number("g", 0.1, 1.0)},
        "coulomb": {"coulomb": draw.number("F", 0.05, 0.5)},
    }[friction]
    return rm.ContactProblem(
        mesh=mesh,
        law=laws,
        dirichlet=supports,
        obstacle=replace(_foundation(draw), **bounds),
        tractions=loads,
        motion=rm.Motion(0),
        design=tuple(draw.variables),
    )


def _foundation(draw: _Draw) -> rm.Obstacle:
    """Flat, tilted, curved or round, below the bottom y = 0."""
    depth = draw.number("h0", 0.011, 0.03)
    kind = draw.one_of(["flat", "tilted", "curved", "circle"])
    if kind == "circle":
        radius = draw.number("R", 2.0, 8.0)
        return rm.Obstacle.circle(
            "bottom", (LENGTH * draw.number("centre", 0.4, 0.7), -depth - radius), radius
        )
    slope = 0.0 if kind == "flat" else draw.number("slope", -0.01, 0.01)
    bend = draw.number("bend", -0.02, 0.04) if kind == "curved" else 0.0
    return rm.Obstacle.graph("bottom", lambda x, y: -depth + slope * (x - 1) - bend * (x - 1) ** 2)


def _membrane(draw: _Draw) -> rm.ContactProblem:
    """A scalar problem above an obstacle, or with a unilateral boundary."""
    mesh = _mesh(draw)
    source = draw.number("source", -4.0, -2.0)
    wave = draw.number("wave", -1.0, 1.0)
    load = lambda x, y: source + wave * ca.sin(3 * x)  # noqa: E731
    laws = _by_region(mesh, lambda name: rm.Laplace(load, draw.number(f"k{name}", 0.5, 2.0)))
    depth, bend = draw.number("h0", 0.1, 0.3), draw.number("bend", -0.1, 0.1)
    psi = lambda x, y: -depth + bend * (x - 1) ** 2  # noqa: E731
    obstacle = (
        rm.Obstacle.interior(psi)
        if draw.rng.random() < 0.5
        else rm.Obstacle("right", (1.0,), lambda x, y: -psi(x, y))
    )
    return rm.ContactProblem(
        mesh=mesh,
        law=laws,
        dirichlet=(rm.Dirichlet("left", (0.0,)),),
        obstacle=obstacle,
        motion=rm.Motion(0),
        design=tuple(draw.variables),
    )


def _designed(draw: _Draw, problem: rm.ContactProblem) -> rm.ContactProblem:
    """With shapes, enough variables, and perhaps nodes that are relocated."""
    moved = draw.one_of(["bottom", "top", ""])
    count = int(draw.rng.integers(1, 7)) if moved else 0
    draw.shapes(moved or "bottom", max(count, FEWEST - len(draw.variables)))
    motion = rm.Motion(rm.Relative(0.2)) if draw.rng.random() < 0.5 else problem.motion
    return replace(problem, design=tuple(draw.variables), motion=motion)


@dataclass(frozen=True)
class _Known:
    """The problem at the feasible design, and the names of what is measured of it."""

    outer: rm.Outer
    contact: str | None  # boundary with contact
    free: str  # boundary whose displacement is measured
    u: str

    def value(self, text: str) -> float:
        """Value of an objective."""
        return float(self.outer.minimising(rm.objective(text)).at_start.value)

    def largest_pressure(self) -> float:
        """Over all contact nodes."""
        space, nodes = self.outer.discretisation.space, np.asarray(self.outer.problem.mesh.p)
        return float(np.max(self.outer.contact.given.normal_force / space.weights(nodes)))


def _stated(draw: _Draw, problem: rm.ContactProblem) -> RandomDesign | None:
    """With an objective and constraints; None if nothing is in contact at the feasible design."""
    feasible = {variable.name: float(draw.rng.uniform(*variable.bounds)) for variable in problem.design}
    outer = rm.Outer.of(problem.at_design(feasible))
    state = outer.contact.given
    if state.status is not rm.Status.CONVERGED or not np.any(state.normal_force > 0):
        return None
    at_feasible = outer.problem
    contact, scalar = at_feasible.contact_sets[0].obstacle.boundary, at_feasible.components == 1
    solved = _Known(
        outer,
        contact if isinstance(contact, str) else None,
        "right" if scalar or at_feasible.supports[0].boundary == "top" else "top",
        "u" if scalar else draw.one_of(["ux", "uy"]),
    )
    objective = _objective(draw, solved)
    constraints = _constraints(draw, solved, objective)
    return RandomDesign(replace(problem, constraints=constraints), objective, feasible)


def _objective(draw: _Draw, solved: _Known) -> str:
    free, u, contact = solved.free, solved.u, solved.contact
    shift = draw.rng.uniform(0.8, 1.2)
    mean = solved.value(f"mean({free}, {u})")
    objectives = [f"mean({free}, ({u} - {shift * mean:.4g})**2)", "compliance"]
    objectives += [f"boundary({free}, {u}**2) + mean({free}, (x - 1)*{u})"]
    if u == "u":
        objectives.append("body(u_x**2 + u_y**2)")
    if contact is not None:
        total = shift * solved.value(f"resultant({contact})")
        objectives += [f"level-pressure({contact})", f"square(resultant({contact}) - {total:.4g})"]
        if u != "u":  # a gap that costs more than what closes it
            objectives.append(f"boundary({contact}, {draw.rng.uniform(1.1, 2.0):.2f}*(y + uy) - y)")
    return str(draw.one_of(objectives))


def _constraints(draw: _Draw, solved: _Known, objective: str) -> tuple[rm.Constraint, ...]:
    """Up to three quantities in half of the problems, and a least force where the pressure is levelled."""
    contact, constraints, chosen = solved.contact, [], []
    force = f"resultant({contact})"
    quantities = [f"mean({solved.free}, {solved.u})", "area"]
    if contact is not None:
        quantities += [force, f"max-pressure({contact})"]
    if draw.rng.random() < 0.5:
        chosen = draw.rng.permutation(quantities)[: draw.rng.integers(1, 4)].tolist()
    if objective == f"level-pressure({contact})":  # else no contact is the best
        constraints.append(rm.Constraint(force, ((1 - RELAXED) * solved.value(force), np.inf)))
        chosen = [text for text in chosen if text != force]
    for text in chosen:
        if text.startswith("max"):
            bounds = (-np.inf, (1 + RELAXED) * solved.largest_pressure())
        else:
            at = solved.value(text)
            low, high = at - RELAXED * abs(at), at + RELAXED * abs(at)
            bounds = draw.one_of([(low, high), (low, np.inf), (-np.inf, high)])
        constraints.append(rm.Constraint(text, bounds))
    return tuple(constraints)
