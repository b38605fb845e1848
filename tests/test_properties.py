"""Properties of every problem: random meshes, materials, loads, obstacles and motions.

Frame invariance, derivatives, contact law, validity, and energies that never rise.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from formulations import joint, nested
from rmesh_nlp.audit import equilibrium_residual, law_residual
from rmesh_nlp.equilibrium import ContactModel
from rmesh_nlp.meshes import from_arrays, named
from rmesh_nlp.motion import least_angles
from rmesh_nlp.nlp import Status
from rmesh_nlp.problem import (
    NO_CONTACT,
    ContactProblem,
    Dirichlet,
    Laplace,
    Motion,
    Obstacle,
    PlaneStrain,
    PlaneStress,
    Relative,
    Traction,
    signed_areas,
)
from rmesh_nlp.referee import Referee
from rmesh_nlp.shapes import rectangle

SEEDS = st.integers(0, 10**6)
FEW = settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@dataclass(frozen=True)
class Frame:
    """x = turn @ X + shift, and the inverse for functions of position."""

    turn: np.ndarray
    shift: np.ndarray

    def scalar(self, f: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """The same function of the material point."""
        return lambda x, y: f(*self._back(x, y))

    def vector(self, f: Callable[[Any, Any], tuple[Any, Any]]) -> tuple[Any, Any]:
        """A turned vector field, component by component."""
        return tuple(
            lambda x, y, i=i: sum(self.turn[i, j] * f(*self._back(x, y))[j] for j in range(2))
            for i in range(2)
        )

    def _back(self, x: Any, y: Any) -> tuple[Any, Any]:
        a, b = x - self.shift[0], y - self.shift[1]
        return (
            self.turn[0, 0] * a + self.turn[1, 0] * b,
            self.turn[0, 1] * a + self.turn[1, 1] * b,
        )


STILL = Frame(np.eye(2), np.zeros(2))


def random_problem(seed: int, frame: Frame = STILL, kind: str | None = None) -> ContactProblem:
    """A problem of random kind, seen from a frame."""
    rng = np.random.default_rng(seed)
    nx, ny = rng.integers(3, 6), rng.integers(2, 5)
    mesh = rectangle(int(nx), int(ny), x=(0, 2), diagonal=["rising", "falling"][rng.integers(2)])
    inside, p = mesh.interior_nodes(), mesh.p.copy()
    p[:, inside] += rng.uniform(-0.15, 0.15, (2, inside.size)) / ny
    if rng.integers(2):
        mesh = named(mesh, subdomains={"a": lambda x: x[1] < 0.5, "b": lambda x: x[1] >= 0.5})
    mesh = replace(mesh, doflocs=frame.turn @ p + frame.shift[:, None])
    c, kind = rng.uniform(-1, 1, 12), kind or ["scalar", "membrane", "elastic", "rough"][rng.integers(4)]
    motion = [Motion(Relative(0.3)), Motion((0.05, 0.05)), Motion(None, min_area_fraction=0.2)][
        rng.integers(3)
    ]
    zones = mesh.subdomains is not None
    if kind in ("scalar", "membrane"):
        source = frame.scalar(lambda x, y: -3 + 4 * c[0] * ca.sin(3 * x) + c[1] * x * y)
        law: Any = Laplace(source)
        law = {"a": law, "b": replace(law, conductivity=3.0)} if zones else law
        obstacle = (
            Obstacle("right", (1.0,), 0.1 * c[2])
            if kind == "scalar"
            else Obstacle.interior(-0.2 - 0.1 * c[2])
        )
        return ContactProblem(mesh, law, (Dirichlet("left", (0.1 * c[3],)),), obstacle, motion, quadrature=3)
    force = frame.vector(lambda x, y: (c[0] * x, -1 + c[1] * y * x))
    pressure = frame.vector(lambda x, y: (c[2], -2 + c[3] * x))
    law = [PlaneStrain, PlaneStress][rng.integers(2)](50 + 40 * c[4], 40 + 30 * c[5], force)
    law = {"a": law, "b": replace(law, lame_mu=100.0)} if zones else law
    normal = tuple(frame.turn @ [0, 1])
    height = lambda x, y: -0.01 + 0.005 * c[6] * ca.sin(2 * x)  # noqa: E731
    obstacle = Obstacle(
        "bottom",
        normal,
        frame.scalar(lambda x, y: y - height(x, y)),
        frame.scalar(lambda x, y: 0.5 + 0.3 * x) if kind == "rough" else 0.0,
    )
    given_at_left = tuple(float(v) for v in frame.turn @ [0.01 * c[7], 0.01 * c[8]])
    return ContactProblem(
        mesh,
        law,
        (Dirichlet("left", given_at_left),),
        obstacle,
        motion,
        (Traction("top", pressure),),
        quadrature=3,
    )


@FEW
@given(SEEDS, st.floats(0, 6.3), st.floats(-5, 5), st.floats(-5, 5))
def test_energy_does_not_depend_on_the_frame(seed: int, angle: float, a: float, b: float) -> None:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    here, there = random_problem(seed), random_problem(seed, Frame(turn, np.array([a, b])))
    one, two = (ContactModel(p).solve(p.mesh.p) for p in (here, there))
    assert two.energy == pytest.approx(one.energy, rel=1e-8, abs=1e-10)
    np.testing.assert_allclose(two.normal_force, one.normal_force, atol=1e-7)
    np.testing.assert_allclose(two.tangential_force, one.tangential_force, atol=1e-7)


@FEW
@given(SEEDS)
def test_energy_does_not_depend_on_the_numbering(seed: int) -> None:
    problem, rng = random_problem(seed), np.random.default_rng(seed)
    mesh = problem.mesh
    new, order = rng.permutation(mesh.p.shape[1]), rng.permutation(mesh.t.shape[1])
    nodes = np.empty_like(mesh.p)
    nodes[:, new] = mesh.p
    turned = np.array([np.roll(t, rng.integers(3)) for t in new[problem.triangles.T[order]]])
    place = np.argsort(order)
    renumbered = from_arrays(
        nodes.T,
        turned,
        {name: new[mesh.facets[:, facets]].T for name, facets in mesh.boundaries.items()},
        {name: place[elements] for name, elements in (mesh.subdomains or {}).items()},
    )
    other = replace(problem, mesh=renumbered)
    one, two = ContactModel(problem).solve(mesh.p), ContactModel(other).solve(renumbered.p)
    assert two.energy == pytest.approx(one.energy, rel=1e-10, abs=1e-12)
    np.testing.assert_allclose(
        ContactModel(other).displacement.values(two.u)[:, new],
        ContactModel(problem).displacement.values(one.u),
        atol=1e-10,
    )


@FEW
@given(SEEDS)
def test_contact_law_and_equilibrium_hold_on_any_moved_mesh(seed: int) -> None:
    referee = Referee(random_problem(seed))
    nodes = referee.relocation.nodes(referee.start(seed))
    system, state = referee.model.system(nodes), referee.model.solve(nodes)
    assert state.status is Status.CONVERGED
    assert equilibrium_residual(system, state.u, state.normal_force, state.tangential_force) < 1e-9
    assert law_residual(system, state.u, state.normal_force, state.tangential_force) < 1e-9


@FEW
@given(SEEDS)
def test_energy_gradient_has_second_order_remainders(seed: int) -> None:
    referee, rng = Referee(random_problem(seed)), np.random.default_rng(seed)
    q = 0.5 * referee.start(seed)
    d = rng.uniform(-1, 1, q.size)
    here = referee.reduced(q)
    steps = 1e-3 * 0.5 ** np.arange(4)
    rest = np.array(
        [abs(referee.reduced(q + h * d).value - here.value - h * here.gradient @ d) for h in steps]
    )
    # at rounding there is no rate to see
    if rest[-1] > 1e-11 * max(1.0, abs(here.value)):
        assert np.log2(rest[0] / rest[-1]) / 3 >= 1.9
    else:
        assert rest[0] <= 1e-7 * max(1.0, abs(here.value))


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(SEEDS, st.sampled_from([joint, nested]))
def test_relocation_never_inverts_an_element_nor_raises_the_energy(seed: int, strategy: Any) -> None:
    problem = random_problem(seed)
    solution = strategy.solve(problem)
    assert solution.success, solution.status
    assert solution.energy <= solution.energy_initial + 1e-9 * abs(solution.energy_initial)
    areas = signed_areas(solution.mesh.p, problem.triangles)
    ratio = areas / signed_areas(problem.mesh.p, problem.triangles)
    assert np.min(ratio) >= problem.motion.min_area_fraction * (1 - 1e-6)
    delta = problem.motion.delta
    if isinstance(delta, tuple):
        assert np.all(np.abs(solution.mesh.p - problem.mesh.p) <= np.array(delta)[:, None] * (1 + 1e-9))


@FEW
@given(SEEDS, st.floats(1, 25))
def test_random_starts_keep_areas_and_angles(seed: int, angle: float) -> None:
    problem = random_problem(seed)
    angle = min(angle, 0.9 * float(np.min(least_angles(problem.mesh.p, problem.triangles))))
    referee = Referee(replace(problem, motion=replace(problem.motion, min_angle=angle), obstacle=NO_CONTACT))
    nodes = referee.relocation.nodes(referee.start(seed))
    assert np.min(least_angles(nodes, problem.triangles)) >= angle
    assert np.any(nodes != problem.mesh.p)
