"""Brackets of displacements of both orders around energies that are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from skfem import MeshTri

from rmesh_nlp.certificate import equilibration
from rmesh_nlp.certificate.bracket import AT_NODES, Bracket, bracket
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Laplace, Obstacle, PlaneStrain, Traction
from support.certificates import guess_on

Field = Callable[[Any, Any], Any]


def on(problem: ContactProblem) -> Bracket:
    return bracket(problem, problem.mesh.p, guess_on(problem))


def smooth(n: int, order: int) -> ContactProblem:
    """u = sin(pi x) sin(pi y) under its source and, on the right, its traction; least energy -pi^2 / 4."""
    source = Laplace(lambda x, y: 2 * np.pi**2 * ca.sin(np.pi * x) * ca.sin(np.pi * y))
    pull = Traction("right", (lambda x, y: -np.pi * ca.sin(np.pi * y),))
    return ContactProblem(rectangle(n, n), source, ("left", "bottom", "top"), tractions=pull, order=order)


def pulled(mesh: MeshTri, ux: Field, uy: Field, **settings: Any) -> ContactProblem:
    """A harmonic displacement with this gradient, under its fluxes at the sides of a box."""
    out = {"west": lambda x, y: -ux(x, y), "east": ux, "south": lambda x, y: -uy(x, y), "north": uy}
    loads = tuple(Traction(side, (flux,)) for side, flux in out.items() if side in mesh.boundaries)
    return ContactProblem(mesh, Laplace(), tractions=loads, **settings)


def signorini(n: int, order: int) -> ContactProblem:
    """r^(3/2) cos(3 t / 2), which leaves the obstacle at the origin; held where it touches left of -1/2."""
    mesh = rectangle(2 * n + 1, n, x=(-1, 1)).with_boundaries(
        {
            "west": lambda x: np.isclose(x[0], -1),
            "east": lambda x: np.isclose(x[0], 1),
            "north": lambda x: np.isclose(x[1], 1),
            "held": lambda x: np.isclose(x[1], 0) & (x[0] < -0.5),
            "free": lambda x: np.isclose(x[1], 0) & (x[0] > -0.5),
        }
    )

    def size(x: Any, y: Any) -> Any:
        return 1.5 * (x * x + y * y) ** 0.25

    ux, uy = (
        (lambda x, y: size(x, y) * ca.cos(ca.atan2(y, x) / 2)),
        (lambda x, y: -size(x, y) * ca.sin(ca.atan2(y, x) / 2)),
    )
    return pulled(mesh, ux, uy, dirichlet=("held",), obstacle=Obstacle("free", (1.0,)), order=order)


def less_half_the_work(corners: list[complex]) -> float:
    """Least energy of the real part of z^(3/2), by the work of its fluxes along a polygon."""
    s, weights = np.polynomial.legendre.leggauss(200)
    total = 0.0
    for a, b in pairwise(corners):
        z = a + (b - a) * (1 + s) / 2
        log = np.log(np.abs(z)) + 1j * np.mod(np.angle(z), 2 * np.pi)
        # the flux out of the body is the derivative along -i (b - a)
        flux = np.real(-1j * (b - a) * 1.5 * np.exp(0.5 * log))
        total += weights / 2 @ (np.real(np.exp(1.5 * log)) * flux)
    return -total / 2


EXACT = {
    smooth: -(np.pi**2) / 4,
    signorini: less_half_the_work([1, 1 + 1j, -1 + 1j, -1]),
}


@pytest.mark.parametrize(
    ("make", "order", "rate"),
    [
        (smooth, 1, 2),
        (smooth, 2, 4),
        pytest.param(signorini, 1, 2, marks=pytest.mark.slow),
        (signorini, 2, 3),
    ],
)
def test_the_bracket_holds_the_least_energy_and_closes_at_the_rate_of_the_order(make, order, rate) -> None:
    widths = []
    for n in (4, 8):
        found = on(make(n, order))
        assert set(found.why) <= {f"upper: {AT_NODES}"}
        assert found.lower < EXACT[make] < found.upper
        assert found.upper - found.lower < 1.45 * (found.upper - EXACT[make])
        assert np.sum(found.local) == pytest.approx(found.upper - found.lower, rel=1e-4)
        assert np.all(found.local >= 0)
        widths.append(found.upper - found.lower)
    assert np.log2(widths[0] / widths[1]) > rate - 0.3


def scalar() -> ContactProblem:
    return ContactProblem(rectangle(4, 4), Laplace(-5.0), ("left",), Obstacle("bottom", (1.0,), 0.8), order=2)


def membrane() -> ContactProblem:
    sides = ("left", "right", "top", "bottom")
    return ContactProblem(rectangle(4, 4), Laplace(-5.0), sides, Obstacle.interior(-0.1), order=2)


def frictional() -> ContactProblem:
    law, pull = PlaneStrain(10.0, 8.0, (0.0, -1.0)), Traction("top", (0.3, -0.5))
    rough = Obstacle("bottom", friction=0.1)
    return ContactProblem(rectangle(6, 3, x=(0, 2)), law, ("left",), rough, tractions=pull, order=2)


@pytest.mark.parametrize("warm", [True, False])
@pytest.mark.parametrize("make", [scalar, membrane, frictional])
def test_the_lower_bound_of_order_2_does_not_depend_on_the_guess(make, warm, monkeypatch) -> None:
    """Contact and friction of the field are found exactly, from any contact that it begins with, or cold."""
    solve = equilibration.solve
    if not warm:
        failed = {"status": Status.CYCLED, "u": np.nan}
        monkeypatch.setattr(
            equilibration, "solve", lambda system, *start: replace(solve(system), **(failed if start else {}))
        )
    problem = make()
    guess = guess_on(problem)
    assert np.any(guess.pressure > 0)
    one, other = on(problem), bracket(problem, problem.mesh.p, guess_on(problem, 0 * guess.displacement))
    assert other.lower == pytest.approx(one.lower, rel=1e-9)
    assert not other.lower_faults


def test_it_is_a_bound_where_the_contact_of_the_field_is_not_found(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, solve = signorini(4, 2), equilibration.solve
    best = on(problem)

    def failed(*given):
        state = solve(*given)
        return replace(state, normal_force=state.normal_force / 2, status=Status.CYCLED, u=np.nan)

    monkeypatch.setattr(equilibration, "solve", failed)
    found = on(problem)
    assert not found.lower_faults
    assert found.lower < best.lower * (1 + 1e-3)
