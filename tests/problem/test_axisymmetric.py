"""Bodies of revolution against closed forms: Lamé's cylinder and ring, Hertz's ball."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.fem.element import differentiated
from rmesh_nlp.fem.energy import strain
from rmesh_nlp.fem.fields import Fields
from rmesh_nlp.fem.stress import strain_energies, stresses
from rmesh_nlp.problem import Law, Place
from support.orders import ORDERS

PARTS = Path(__file__).parents[2] / "docs" / "parts"
YOUNG, POISSON, PRESSURE = 1000.0, 0.3, 10.0
LAW = rm.Axisymmetric.from_young(YOUNG, POISSON)


def pressed(n: int, inner: float, order: int, law: Law = LAW, **more: object) -> rm.ContactProblem:
    """A ring, 1 high, or with ``inner`` 0 a cylinder, under a pressure at r = 2."""
    given = {"dirichlet": (rm.Dirichlet("bottom", (None, 0.0)),), "name": "ring"} | more
    given = {"tractions": (rm.Traction("right", (-PRESSURE, 0.0)),)} | given
    return rm.ContactProblem(mesh=rm.shapes.rectangle(n, n, x=(inner, 2.0)), law=law, order=order, **given)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("formulation", ["fixed", "joint"])
def test_cylinder_is_exact_and_its_axis_stays(order: int, formulation: str) -> None:
    solution = rm.solve(pressed(3, 0.0, order), formulation)
    r, z = X = solution.mesh.p
    u = solution.displacement[:, : r.size]
    np.testing.assert_allclose(u[0], -PRESSURE * (1 - POISSON) / YOUNG * r, atol=1e-13)
    np.testing.assert_allclose(u[1], 2 * POISSON * PRESSURE / YOUNG * z, atol=1e-13)
    assert np.sum(r == 0) == 4
    values = stresses(solution.problem, X, solution.displacement)
    wanted = np.array([-PRESSURE, 0.0, 0.0, -PRESSURE])  # rr, zz, rz, hoop
    np.testing.assert_allclose(values, wanted[:, None] + 0 * values, atol=1e-9)
    record, local = solution.record(), strain_energies(solution.problem, X, solution.displacement)
    assert local.sum() == pytest.approx(-record["energy"], rel=1e-12)
    assert record["success"]
    assert record["energy"] == pytest.approx(-(PRESSURE**2) * (1 - POISSON) / YOUNG * 4 * np.pi, rel=1e-12)
    assert record["energy_audited"] == pytest.approx(record["energy"], rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_ring_converges_to_lame_at_the_rate_of_its_order(order: int) -> None:
    def lame(x: ca.SX, y: ca.SX) -> ca.SX:  # Timoshenko and Goodier, Theory of elasticity, art. 28
        c = -PRESSURE * 4 / 3
        return ca.vertcat((1 + POISSON) / YOUNG * ((1 - 2 * POISSON) * c * x + c / x), 0)

    ends = tuple(rm.Dirichlet(name, (None, 0.0)) for name in ("bottom", "top"))
    exact = rm.ExactSolution(lame, 0.0)
    first, second = (
        rm.solve(pressed(n, 1.0, order, dirichlet=ends, exact=exact), "fixed", objective="error-l2").record()
        for n in (4, 8)
    )
    rate = np.log2(first["objective_value"] / second["objective_value"]) / 2
    assert rate == pytest.approx(order + 1, abs=0.2)


def on_plane(friction: float, **more: object) -> rm.ContactProblem:
    support = rm.Obstacle.line("bottom", point=(0.0, 0.0), normal=(0.0, 1.0), friction=friction)
    return pressed(4, 0.5, 1, dirichlet=(), obstacle=support, motion=rm.Motion(0.05), **more)


@pytest.mark.slow
@pytest.mark.parametrize(("order", "inner"), [(1, 0.0), (1, 0.5), (2, 0.0), (2, 0.5)])
def test_energy_is_that_of_its_displacement_on_coarse_meshes_near_the_axis(order: int, inner: float) -> None:
    down = (rm.Traction("top", (3.0, -20.0)),)  # bends, so that u_r / r is no polynomial
    record = rm.solve(pressed(2, inner, order, tractions=down), "joint").record()
    assert record["energy"] == pytest.approx(record["energy_audited"], rel=5e-7)


@pytest.mark.parametrize("order", [1, 2])
def test_stiffness_takes_few_times_the_operations_of_plane_strain(order: int) -> None:
    def operations(law: Law) -> float:
        parts = discretise(pressed(6, 0.0, order, law, dirichlet="bottom"))
        groups = strain(Fields(parts.space, parts.vertices.positions, parts.displacement, parts.slip))
        each = [differentiated(one.function, None, (len(one.arguments) - 1,)).second for one in groups]
        return sum(one.n_instructions() * group.size for one, group in zip(each, groups, strict=True))

    assert operations(LAW) < 6 * operations(rm.PlaneStrain.from_young(YOUNG, POISSON))


@pytest.mark.slow
def test_hollow_sphere_under_pressure_is_that_of_lame() -> None:
    """Timoshenko and Goodier, Theory of elasticity, art. 136: radii 1 and 2, half of it above its equator."""
    mesh = rm.shapes.rectangle(4, 6, y=(0.0, np.pi / 2), x=(1.0, 2.0))
    rho, angle = mesh.p
    mesh = replace(mesh, doflocs=np.stack([rho * np.cos(angle), rho * np.sin(angle)]))
    problem = rm.ContactProblem(
        mesh=mesh,
        law=LAW,
        dirichlet=rm.Dirichlet("bottom", (None, 0.0)),
        tractions=rm.Traction("right", (lambda x, y: -PRESSURE * x / 2, lambda x, y: -PRESSURE * y / 2)),
        motion=rm.Motion(curves={"left": rm.Circle((0, 0), 1), "right": rm.Circle((0, 0), 2)}),
        order=2,
    )
    record = rm.solve(problem, "fixed").record()
    sink = PRESSURE * 8 / 7 * (2 * (1 - 2 * POISSON) + (1 + POISSON) / 8) / YOUNG  # of r = 2
    assert record["energy_audited"] == pytest.approx(-4 * np.pi * PRESSURE * sink, rel=2e-4)
    assert record["energy"] == pytest.approx(record["energy_audited"], rel=1e-6)


@pytest.mark.slow
def test_force_is_of_the_whole_revolution_and_contact_alone_holds_it() -> None:
    down = (rm.Traction("right", (-PRESSURE, 0.0)), rm.Traction("top", (0.0, -20.0)))
    problem = replace(on_plane(1.0), tractions=down, units=rm.Units("mm", "N"))
    solution, others = rm.solve(problem, "joint"), [rm.solve(problem, one) for one in ("nested", "mpcc")]
    record = solution.record()
    assert [one.record()["energy"] for one in others] == pytest.approx([record["energy"]] * 2, rel=1e-5)
    assert record["gain_audited"] > 0
    assert record["resultant"] == pytest.approx(20 * np.pi * (4 - 0.25), rel=1e-9)
    assert record["units"] == {"length": "mm", "force": "N", "per": "revolution"}
    rows = dict(solution.summary())
    assert "bottom: normal force [N, whole revolution]" in rows
    force, axial = record["contact"]["bottom"], "bottom: axial force on the body [N, whole revolution]"
    assert float(rows[axial]) == pytest.approx(force["force_y"], rel=1e-5)
    assert force["tangential_force"] != 0  # which cancels around the axis
    assert force["force_y"] == pytest.approx(record["resultant"], rel=1e-9)
    assert force["force_x"] == force["moment"] == 0
    assert "bottom: peak pressure [N/mm²]" in rows
    for objective in ("energy", "level-pressure(bottom)", "mean(right, ux) + area"):
        assert rm.verify_gradient(problem, objective).order == pytest.approx(2, abs=0.1), objective


def test_traction_on_the_axis_is_warned_of() -> None:
    pulled = pressed(2, 0.0, 1, tractions=(rm.Traction("left", (0.0, 1.0)), rm.Traction("top", (0.0, 1.0))))
    (said,) = rm.solve(pulled, "fixed", audit=False).record()["warnings"]
    assert said == "component 2 of the traction on 'left' has no effect: r is 0 there"


def test_certificate_of_a_body_on_its_axis_is_refused_in_words() -> None:
    told = rm.solve(pressed(2, 0.0, 1), "fixed", certify=True).record()["certificate_remark"]
    assert "meets its axis" in told
    assert told.endswith("--accuracy estimates errors")


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("kind", ["elastic", "rubbing", "membrane"])
def test_bounds_of_a_ring_hold_on_finer_meshes(kind: str, order: int) -> None:
    held = rm.Dirichlet("top", (lambda x, y: 0.02 * (x - 1.2), -0.02))
    rough = rm.Obstacle.graph("bottom", lambda x, y: 0.01 * (x - 0.5), friction=4.0 * (kind == "rubbing"))
    pulled = (lambda x, y: 20 * x * y, -10.0)
    given = {"law": replace(LAW, body_force=pulled), "dirichlet": held, "obstacle": rough}
    if kind == "membrane":
        law, below = rm.Laplace(-40.0, axisymmetric=True), rm.Obstacle(Place.INTERIOR, (1.0,), 0.8)
        given = {"law": law, "dirichlet": "right", "obstacle": below, "tractions": ()}
    problem = pressed(2, 0.5, order, **given)
    solution = rm.solve(problem, "fixed", certify=True)
    fine = rm.solve(rm.refined(rm.refined(replace(problem, order=2))), "fixed", audit=False)
    found = solution.certificate
    assert found.is_guaranteed
    assert found.lower <= fine.energy <= found.upper
    assert found.upper - found.lower < 0.3 / order * abs(fine.energy)
    if kind != "membrane":
        bounds = found.bounds["resultant(bottom)"]
        assert bounds.lower < fine.contact["bottom"]["normal_force"] < bounds.upper


def test_laplace_of_revolution() -> None:
    law = rm.Laplace(-4.0, axisymmetric=True)  # u = r^2 - 4
    mesh = rm.shapes.rectangle(3, 2, x=(0.0, 2.0))
    problem = rm.ContactProblem(mesh=mesh, law=law, dirichlet="right", order=2)
    record = rm.solve(problem, "joint").record()
    assert record["energy_audited"] == pytest.approx(-16 * np.pi, rel=1e-12)
    assert record["u_min"] == pytest.approx(-4, rel=1e-12)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"inner": -0.5}, "r >= 0, got -0.5 at node"),
        ({"dirichlet": (rm.Dirichlet("left", (0.1, 0.0)),)}, "on the axis u_r is 0: node 0 cannot"),
    ],
)
def test_what_no_body_of_revolution_has_is_refused(change: dict[str, object], said: str) -> None:
    with pytest.raises(rm.ProblemError, match=said):
        pressed(**({"n": 2, "inner": 0.0, "order": 1} | change))


@pytest.mark.slow
def test_ball_on_plane_is_that_of_hertz() -> None:
    """K. L. Johnson, Contact mechanics, eq. (4.22)-(4.24)."""
    record = rm.solve(rm.read_problem(PARTS / "ball.toml"), "fixed").record()
    assert record["resultant"] == pytest.approx(5.8904e7, rel=1e-3)
    assert record["peak_pressure"] == pytest.approx(1.53594e7, rel=0.015)
    assert record["contact_length"] == pytest.approx(1.35318, rel=0.02)
