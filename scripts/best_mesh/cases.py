"""The problems of the benchmark, without move limits, and how the error of a mesh is measured on each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from skfem import Basis, MeshTri

import rmesh_nlp as rm
from best_mesh import adaptive as plain
from best_mesh.adaptive import Equations, OnPoints, nothing
from gallery import free_boundary, of_file, signorini
from rmesh_nlp.assessment.admissible import admissible
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.examples import EXACT_ENERGY_61, EXAMPLES
from rmesh_nlp.fem.interpolation_error import errors
from rmesh_nlp.meshes import named
from rmesh_nlp.models.attainable import LeastErrors
from rmesh_nlp.models.remeshing import Solved
from rmesh_nlp.problem import ContactProblem, Motion
from rmesh_nlp.problem.contact_problem import locally_refined, refined

RULE = 6
FINE_NODES = 20_000


def next_mesh(problem: ContactProblem) -> ContactProblem:
    """Refined in the triangles with half of the interpolation error, by recovered second derivatives."""
    indicators, corners = np.zeros(problem.mesh.t.shape[1]), np.asarray(problem.mesh.p)[:, problem.triangles]
    for one in Solved.of(problem).regions:
        indicators[one.elements] = errors(one.law, corners[:, :, one.elements], one.in_elements)
    order = np.argsort(-indicators, kind="stable")
    share = np.cumsum(indicators[order])  # W. Dörfler, SIAM J. Numer. Anal. 33 (1996) 1106-1124
    return locally_refined(problem, order[: 1 + int(np.searchsorted(share, share[-1] / 2))])


@dataclass(frozen=True)
class Case:
    """A problem at several sizes, without move limits, and perhaps its ``equations`` for scikit-fem.

    ``known`` is the energy that errors are measured against.
    """

    name: str
    sizes: tuple[int, ...]
    make: Callable[[int], ContactProblem]
    equations: Equations | None = None
    known: float = float("nan")

    def problem(self, size: int, order: int = 1) -> ContactProblem:
        """That of a size, with displacements of an order."""
        given = self.make(size)
        motion = Motion(None, curves=given.motion.curves)
        return replace(given, motion=motion, quadrature=RULE, order=order)

    @cached_property
    def fine(self) -> ContactProblem:
        """Refined locally to some 20,000 nodes; new nodes of curves are on them."""
        problem = replace(self.problem(self.sizes[0]), exact=None, reference=None)
        while problem.mesh.p.shape[1] < FINE_NODES:
            problem = next_mesh(problem)
        return problem

    def least(self, triangles: int) -> float:
        """The least interpolation error of a number of triangles, by the solution on the fine mesh."""
        regions = Solved.of(self.fine).regions
        return LeastErrors.of(np.asarray(self.fine.mesh.p), regions, triangles).any_mesh

    @property
    def slope(self) -> OnPoints | None:
        """Gradients of the exact solution, if they are known."""
        return self.equations.slope if self.equations is not None else None

    def error(self, problem: ContactProblem) -> float:
        """Error of a mesh: of its assessed energy, or half its square in the energy norm."""
        if self.slope is None:
            return admissible(problem).energy - self.known
        model = ContactSolver(problem)
        space, coefficients = model.discretisation.space, model.displacement.values(model.given.u)
        basis = Basis(MeshTri(problem.mesh.p, problem.mesh.t), plain.ELEMENTS[problem.order])
        return plain.half_square(basis, space.values(coefficients)[0], self.slope)

    def error_of(self, end: plain.Solved) -> float:
        """The same of a solution by scikit-fem."""
        if self.slope is None:
            return end.energy - self.known
        return plain.half_square(end.basis, end.u, self.slope)


def _finer(problem: ContactProblem, times: int) -> ContactProblem:
    """Refined uniformly."""
    for _ in range(times):
        problem = refined(problem)
    return problem


def _plate(times: int) -> ContactProblem:
    """A plate with a round hole, pulled to the right; no contact."""
    problem = ContactProblem(
        rm.shapes.plate_with_hole(1.25),
        rm.PlaneStrain.from_young(1000.0, 0.3),
        (rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("bottom", (None, 0.0))),
        tractions=(rm.Traction("right", (10.0, 0.0)),),
        motion=Motion(None, curves={"hole": rm.Circle((5.0, 5.0), 2.5)}),
    )
    return _finer(problem, times)


def _hertz(n: int) -> ContactProblem:
    """The quarter disc of the gallery without its chord: contact nodes are on the arc and slide along it."""
    circle, chord = rm.Circle((0.0, 1.0), 1.0), of_file("hertz", h=1.6 / n, h_contact=0.12 / n)
    p, nodes = np.array(chord.mesh.p), chord.contact_nodes
    p[1, nodes] = 1 - np.sqrt(1 - p[0, nodes] ** 2)
    return replace(
        chord,
        mesh=replace(chord.mesh, doflocs=p),
        obstacle=rm.Obstacle.graph("contact", 0.0),
        motion=Motion(None, curves={"contact": circle, "arc": circle}),
    )


def mode(x: Any, y: Any) -> Any:
    """``r^(2/3) sin(2 phi/3)`` about (0.5, 0.5); phi is 0 on the upper edge of the notch."""
    a, b = x - 0.5, y - 0.5
    # turned by 135 degrees, so that the branch cut of atan2 is in the notch
    phi = ca.atan2(a - b, -a - b) + 3 * np.pi / 4
    return (a * a + b * b + 1e-30) ** (1 / 3) * ca.sin(2 * phi / 3)


def _mode(slides: int) -> ContactProblem:
    """The L-shape of jNO's tutorial "adaptive_l_shape", edges 0.12 long as there (104 nodes for its 92).

    The boundary is held as it is there, or (``slides``) zeros are given as numbers on the edges of the notch,
    so that nodes slide along them.
    """
    points = [(0.0, 0.0), (1.0, 0.0), (1.0, 0.5), (0.5, 0.5), (0.5, 1.0), (0.0, 1.0)]
    mesh = rm.shapes.polygon(points, 0.12, {"notch": [2, 3], "outer": [0, 1, 4, 5]})
    notch = rm.Dirichlet("notch", (0.0 if slides else mode,))
    exact = rm.ExactSolution(mode, float("nan"))
    return ContactProblem(mesh, rm.Laplace(), (notch, rm.Dirichlet("outer", (mode,))), exact=exact)


def _corner(n: int) -> ContactProblem:
    """The same solution on a uniform grid of squares, ``n`` along each edge of the notch, which slide."""
    mesh = rm.shapes.rectangle(2 * n, 2 * n, diagonal="falling")
    mesh = mesh.remove_elements(np.flatnonzero(np.all(mesh.p[:, mesh.t].mean(axis=1) > 0.5, axis=0)))
    in_notch = lambda x: np.all(x >= 0.5, axis=0)  # noqa: E731
    mesh = MeshTri(mesh.p, mesh.t).with_boundaries({"notch": in_notch, "outer": lambda x: ~in_notch(x)})
    return replace(_mode(1), mesh=mesh)


def _two_materials(n: int) -> ContactProblem:
    """A square, its lower right part ten times stiffer, its top pushed down and sideways."""
    mesh = named(
        rm.shapes.rectangle(n, n),
        subdomains={
            "stiff": lambda x: (x[0] > 5 / 9) & (x[1] < 4 / 9),
            "soft": lambda x: (x[0] < 5 / 9) | (x[1] > 4 / 9),
        },
    )
    laws = {"stiff": rm.PlaneStrain.from_young(1e4, 0.3), "soft": rm.PlaneStrain.from_young(1e3, 0.3)}
    return ContactProblem(mesh, laws, ("bottom", rm.Dirichlet("top", (0.02, -0.03))))


def _membrane(n: int) -> ContactProblem:
    """A membrane under a load, over a hill that it touches."""
    psi = lambda x, y: -0.03 - 3 * ((x - 0.6) ** 2 + (y - 0.45) ** 2)  # noqa: E731
    sides = ("left", "right", "bottom", "top")
    return ContactProblem(rm.shapes.rectangle(n, n), rm.Laplace(-2.0), sides, rm.Obstacle.interior(psi))


def _supports(n: int) -> ContactProblem:
    """Half of a beam under its own weight, on a rough support in its middle and one near its end."""
    feet = {"feet": lambda x: (x[1] == 0) & ((x[0] < 0.5) | ((x[0] > 3) & (x[0] < 3.5)))}
    return ContactProblem(
        named(rm.shapes.rectangle(4 * n, n, x=(0, 4)), feet),
        rm.PlaneStrain.from_young(1000.0, 0.3, (0.0, -4.0)),
        (rm.Dirichlet("left", (0.0, None)),),
        rm.Obstacle.graph("feet", 0.0, friction=1.0),
    )


def _bracket(times: int) -> ContactProblem:
    """An angle bracket, its upper end clamped, its foot loaded above a foundation."""
    points = [(0.0, 0.0), (3.0, 0.0), (3.0, 1.0), (1.0, 1.0), (1.0, 3.0), (0.0, 3.0)]
    names = {"foot": [0], "tip": [1], "load": [2], "inner": [3], "clamp": [4], "back": [5]}
    problem = ContactProblem(
        rm.shapes.polygon(points, 0.25, names),
        rm.PlaneStress.from_young(2.1e5, 0.3),
        ("clamp",),
        rm.Obstacle.graph("foot", -2e-4),
        tractions=(rm.Traction("load", (0.0, -10.0)),),
    )
    return _finer(problem, times)


def _everywhere(x: Array) -> Array:
    return np.ones(x.shape[1], dtype=bool)


def _constant(value: float) -> Callable[[Array], Array]:
    return lambda x: np.full(x.shape[1:], value)


def _exact(solution: Callable[[Any, Any], Any]) -> tuple[OnPoints, OnPoints]:
    """A function of CasADi and its gradient, at points (2, ...)."""
    x = ca.SX.sym("x", 2)
    value = solution(x[0], x[1])

    def at(part: ca.SX, *shape: int) -> OnPoints:
        compiled = ca.Function("exact", [x], [part])
        return lambda points: np.asarray(compiled(points.reshape(2, -1))).reshape(*shape, *points.shape[1:])

    return at(value), at(ca.gradient(value, x), 2)


def _plane_strain(lame: float, mu: float) -> Callable[[Array], Array]:
    """Stress of gradients (2, 2, ...) of the displacement."""

    def stress(gradient: Array) -> Array:
        trace = lame * (gradient[0, 0] + gradient[1, 1])
        shear = mu * (gradient[0, 1] + gradient[1, 0])
        return np.array([[trace + 2 * mu * gradient[0, 0], shear], [shear, trace + 2 * mu * gradient[1, 1]]])

    return stress


def _loaded(x: Array) -> Array:
    """The right half of the block's top."""
    return (x[1] == 1) & (x[0] > 2)


def _source_61(points: Array) -> Array:
    """-Laplace of the exact solution (6.2), differentiated by hand."""
    (x, y), pi = points, np.pi
    a = 0.5 - y
    lower = 200 * np.sin(2 * pi * x) * (4 * pi**2 * y * a**4 + 8 * a**3 - 12 * y * a**2)
    upper = 100 * np.sin(pi / 2 * x) * (pi**2 / 4 * (1 - y) * a**4 - 8 * a**3 - 12 * (1 - y) * a**2)
    return np.where(y <= 0.5, lower, upper)


EQUATIONS_61 = Equations(
    _source_61,
    lambda x: (x[0] == 0) | (x[1] == 0) | (x[1] == 1),
    lambda x: x[0] == 1,
)
TORSION = Equations(_constant(1.0), _everywhere)
MODE = Equations(nothing, _everywhere, nothing, *_exact(mode))
RADIAL = Equations(_constant(-2.0), _everywhere, _everywhere, *_exact(free_boundary.exact))
ROOT = Equations(
    nothing,
    lambda x: (abs(x[0]) == 1) | (x[1] == 1),
    lambda x: x[1] == 0,
    *_exact(signorini.exact),
)

WEDGE = Equations(
    nothing,
    lambda x: x[0] == 0,
    lambda x: x[1] == 0,
    components=2,
    stress=_plane_strain(1.15e4, 0.83e4),
    traction=lambda x: np.stack([-20.0 * _loaded(x), -57.5 * _loaded(x)]),
    offset=lambda x: -np.interp(x[0], (0.0, 3.0, 4.0), (-0.12, -0.03, -0.06)),
    friction=lambda x: 5 * x[0],
)

CASES = {
    case.name: case
    for case in (
        Case("6.1", (8, 16, 24, 32, 48, 64), EXAMPLES["6.1"], EQUATIONS_61, EXACT_ENERGY_61),
        Case(
            "L-shape",
            (0, 1, 2),
            lambda times: _finer(of_file("l_shape", h=1 / 6), times),
            TORSION,
            -0.2140758036 / 2,  # in the literature on adaptive finite elements
        ),
        Case("6.3", (6, 12, 24), lambda n: EXAMPLES["6.3"](n=(2 * n, n))),
        Case("wedge", (6, 12), lambda n: of_file("wedge", nx=4 * n, ny=n), WEDGE),
        Case("free boundary", (8, 16, 32), free_boundary.problem, RADIAL),
        Case("plate", (0, 1), _plate),
        Case("Signorini", (10, 20), signorini.problem, ROOT),
        Case("Hertz", (4, 9), _hertz),
        Case("jNO's L-shape, held", (0,), lambda _: _mode(0), MODE),
        Case("jNO's L-shape", (1,), _mode, MODE),
        Case("two materials", (9, 27), _two_materials),
        Case("punch", (11, 23), lambda n: of_file("punch", nx=n, ny=n)),
        Case("membrane", (11, 29), _membrane),
        Case("two supports", (8, 16), _supports),
        Case("bracket", (0, 1), _bracket),
    )
}
"""Nothing was chosen on the last five."""

MORE = {
    case.name: case
    for case in (
        Case("L-shape r^(2/3)", (4, 8, 16), _corner, MODE),
        Case("6.2", (0, 1, 2), lambda times: _finer(EXAMPLES["6.2"](), times)),
    )
}
"""Cases of the benchmark of orders alone."""
