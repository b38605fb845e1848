"""The solver of ``scripts/soak_truth.py`` against closed forms, and that it notices what is wrong."""

import ast
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rmesh_nlp as rm
import soak_truth as soak
from truth.body import Body
from truth.contact import accurate_loads, equilibrium, friction, least
from truth.data import Data, Foundation, Hidden, Material, formula, values
from truth.draws import KINKS, STEPS, aimed, block, disc, ring
from truth.reference import doubt, reference, refined

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def pressed_block(**more: Any) -> Any:
    """A block of plane stress on a flat foundation, under a pressure of 3."""
    steel = (Material("plane-stress", (0.0, 0.0), 50.0, 0.3),)
    flat = Foundation("bottom", "height", 0.0)
    mesh = block(3, 2, 2, np.random.default_rng(1))
    one = Data("block", mesh, steel, flat, {"left": (0.0, None)}, {"top": (0.0, -3.0)})
    return replace(one, **more)


def membrane(load: str, foundation: Any, held: dict[str, Any], n: int) -> Any:
    mesh = block(n, n, 1)
    return Data("membrane", mesh, (Material("laplace", (load,)),), foundation, held)


ORDERS = pytest.mark.parametrize("order", [1, 2])


@ORDERS
def test_patch_test(order: int) -> None:
    """Uniform stress, which piecewise linear displacements have exactly."""
    found = least(pressed_block(order=order), pressed_block().mesh)
    assert found.converged
    np.testing.assert_allclose(found.energy, -(3**2) / 50, rtol=1e-9)  # -p^2 / (2 E) over an area of 2
    assert found.resultant == pytest.approx(6, rel=1e-8)


@ORDERS
def test_obstacle_below_a_string(order: int) -> None:
    """-u'' = -f, u >= -c: contact from a = sqrt(2 c / f) on, energy -c f (1 - 4 a / 3)."""
    string = Foundation("interior", "interior", -0.05)
    data = replace(membrane("-2.0", string, {"left": (0.0,), "right": (0.0,)}, 3), order=order)
    found = reference(data, 300)
    exact = -0.1 * (1 - 4 * np.sqrt(0.05) / 3)
    assert found.converged
    assert abs(found.energy - exact) <= found.bar < 3e-3 * abs(exact)


@pytest.mark.slow
def test_energies_that_do_not_fall_regularly_are_known_less() -> None:
    """A membrane over a bump that is narrower than elements at first, J* by 9,000 nodes and more."""
    found = reference(replace(aimed()[32], order=2), 1000)
    assert 1e-6 < abs(found.energy + 0.00697411) <= found.bar < 1e-4
    # falls to a quarter, to half, too fast, not at all, rises
    falls = [(4.0, 1.0, 1 / 3), (2.0, 1.0, 1.0), (40.0, 1.0, 10 / 3), (1.0, 1.0, 1.0), (4.0, -1.0, 4.0)]
    for first, second, bar in falls:
        assert doubt(first, second, 4.0) == pytest.approx(bar)
        assert doubt(-first, -second, 4.0) == pytest.approx(bar)


def test_friction_with_a_bound_that_varies_within_elements() -> None:
    foundation = Foundation("bottom", "height", 0.0, "8*(1+0.95*sin(16*pi*x+0.3))")
    data = pressed_block(foundation=foundation)
    body = Body(data, data.mesh)
    u = np.zeros((body.p.shape[1], 2))
    u[:, 0] = body.p[0] - 0.7  # changes its sign within an edge
    k, phase = 16 * np.pi, 0.3

    def whole(x: float) -> float:  # antiderivative of (x - 0.7) g / 8
        wave = -(x - 0.7) * np.cos(k * x + phase) / k + np.sin(k * x + phase) / k**2
        return (x - 0.7) ** 2 / 2 + 0.95 * wave

    exact = 8 * (whole(2) - 2 * whole(0.7) + whole(0))
    np.testing.assert_allclose(friction(body, u.ravel()), exact, rtol=1e-10)


@ORDERS
def test_domain_of_the_true_curves(order: int) -> None:
    """Areas, and energies of linear and quadratic displacements, are those of the round body on any mesh."""
    steel, lid = (Material("plane-strain", (0.0, 0.0), 7.0, 0.2),), Foundation("arc", "level", "5-y")
    circles = {"arc": (0.0, 0.0, 5.0), "hole": (0.0, 0.0, 3.0)}
    half = Data("disc", disc(3, 2.0, False), steel, lid, {}, {}, {"arc": (0.0, 2.0, 2.0)})
    round_ring = Data("ring", ring(8, 2, 3.0), steel, lid, {}, {}, circles)
    for one, area in ((half, 2 * np.pi), (round_ring, 8 * np.pi)):
        one = replace(one, order=order)
        found = Body(one, one.mesh)
        x, y = found.places
        u = np.stack([0.3 * x + 0.1 * y, -0.2 * x + 0.5 * y], axis=1)
        mu, lam = 7 / 2.4, 7 * 0.2 / (1.2 * 0.6)
        density = lam * 0.8**2 / 2 + mu * (0.3**2 + 0.5**2 + 2 * 0.05**2)
        np.testing.assert_allclose(found.area.sum(), area)
        finer = Body(one, refined(one, one.mesh, np.arange(3)))
        np.testing.assert_allclose(finer.area.sum(), area)
        np.testing.assert_allclose(u.ravel() @ found.stiffness @ u.ravel() / 2, density * area)
        if order == 2 and one.name == "disc":  # y^2 is 4 (y - 2)^2 above the centre, over half a disc
            bent = np.stack([0 * y, (y - 2) ** 2], axis=1).ravel()
            moment = np.pi * 2**4 / 8
            np.testing.assert_allclose(bent @ found.stiffness @ bent / 2, (lam + 2 * mu) * 2 * moment)


@pytest.mark.slow
@ORDERS
def test_gaps_hold_inside_elements(order: int) -> None:
    """Over a bump narrower than an element, which costs energy beside gaps that hold at nodes alone."""
    bump = "-0.05+0.08*exp(-((x-0.45)**2+(y-0.5)**2)/0.03**2)"
    psi = Foundation("interior", "interior", bump)
    data = membrane("-1.0", psi, dict.fromkeys(("left", "right", "bottom", "top"), (0.0,)), 4)
    data = replace(data, order=order)
    best = least(data, data.mesh)
    nodal = equilibrium(best.body, accurate_loads(best.body))
    assert best.converged  # what counts the gaps at 5,000 points of each triangle
    assert best.energy > nodal.energy + 1e-3
    assert best.energy > reference(data, 400).energy


def claimed(mesh: Any, **record: Any) -> SimpleNamespace:
    """A solution of the package that is a success by its own word."""
    said = {"status": "converged", "success": True, "valid": True, "improved": True, "formulation": "joint"}
    said |= {"stationarity_residual": 0.0, "stationarity": "KKT", "energy_initial_audited": None}
    said |= {"energy_audited": None, **record}
    return SimpleNamespace(mesh=mesh, displacement=np.zeros((1, mesh.p.shape[1])), record=lambda: said)


@pytest.mark.slow
def test_false_claims_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    flat = Foundation("right", "offset", 0.01)
    monkeypatch.setattr(soak, "LEVELS", (300,))
    data = membrane("-2+3*sin(7*x)", flat, {"left": (0.0,)}, 4)
    p, inside = np.array(data.mesh.p), data.mesh.interior_nodes()
    p[0, inside] -= 0.1  # away from where the solution bends
    worse = replace(data.mesh, doflocs=p)
    solutions = {
        "fixed": claimed(data.mesh),
        "bad": claimed(worse, error_reduction={"factor": 2.0}, energy_audited=-2.0),
        "good": claimed(data.mesh, error_reduction={"factor": 1.1}, energy_audited=-0.1),
    }
    monkeypatch.setattr(soak, "solved", lambda data, formulation, **options: solutions[formulation])
    bad = soak.checked(replace(data, formulation="bad"))
    assert bad["well_posed"]
    assert {"larger error", "overclaimed", "audited below truth"} <= set(bad["faults"])
    assert soak.checked(replace(data, formulation="good"))["faults"] == []
    assert soak.summary([bad]) == 1


def test_success_without_admissible_displacements_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    data = pressed_block(held={"left": (0.0, -0.1)})
    monkeypatch.setattr(soak, "solved", lambda data, formulation, **options: claimed(data.mesh))
    assert soak.checked(data)["faults"] == ["infeasible success"]


def test_displacements_and_certificates_are_checked() -> None:
    """Against J* = -1 of a mesh with the error 0.02 and a solution with an energy norm error of 0.3."""
    row = {"J": -1.0, "bar": 1e-4, "errors": [0.02, 0.02], "success": True, "claimed": None, "audited": []}
    row |= {"own": [{"J": -0.98, "norm": 0.3}] * 2, "energies": [-0.98] * 2, "fine_error": 1e-4}
    row |= {"resultant": 5.0, "quantity": 1.0}
    sound = {"energy_lower_bound": -1.05, "energy_upper_bound": -0.98, "error_bound": 0.4, "percent": True}
    sound |= {"guaranteed_lower": True, "guaranteed_upper": True, "forces": [(4.5, 5.5)], "quantity": []}
    assert soak.found_faults({**row, "certificate": sound}) == []
    made = soak.certificate(rm.solve(rm.EXAMPLES["6.1"](n=2), "fixed"))
    assert set(made) - {"why"} == set(sound)
    assert all(low <= high for low, high in made["forces"])
    assert soak.found_faults({**row, "own": [{"J": -0.98}, {"J": -0.9}]}) == ["worse displacement"]
    for change, fault in (
        ({"energy_lower_bound": -0.99}, "lower bound"),
        ({"quantity": [(1.1, 1.2)]}, "quantity bounds"),
        ({"energy_upper_bound": -1.01}, "upper bound"),
        ({"error_bound": 0.2}, "error bound"),
        ({"forces": [(5.2, math.inf)]}, "force bounds"),
        ({"forces": [(0.0, 4.8)]}, "force bounds"),
        ({"energy_lower_bound": -1.01, "energy_upper_bound": -1.02}, "crossed bounds"),
    ):
        assert fault in soak.found_faults({**row, "certificate": {**sound, **change}})


def test_nothing_of_the_package_checks_itself() -> None:
    """The soak imports the package's front page only, to make problems and to solve them."""
    for path in (SCRIPTS / "soak_truth.py", *(SCRIPTS / "truth").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                assert not (node.module or "").startswith(("rmesh_nlp", "formulations")), path
            elif isinstance(node, ast.Import):
                assert all(not alias.name.startswith(("rmesh_nlp.", "formulations")) for alias in node.names)


@pytest.mark.slow
def test_a_soak_goes_on_where_it_ended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--first", "1", "--count", "1", "--out", str(tmp_path)]
    soak.main(arguments)
    rows = (tmp_path / "random.jsonl").read_text()
    assert len(rows.splitlines()) == 1
    capsys.readouterr()
    soak.main(arguments)
    assert (tmp_path / "random.jsonl").read_text() == rows
    assert "1 solves" in capsys.readouterr().out


@pytest.mark.parametrize(("plain", "disguises"), [("where(x>{0},1,0)", STEPS), ("fabs(x-{0})", KINKS)])
def test_hidden_jumps_and_kinks_are_what_the_check_knows(plain: str, disguises: tuple[str, ...]) -> None:
    x = np.append(np.linspace(0.01, 1.99, 34), [0.6999, 0.7001])
    points = np.stack([x, 0 * x])
    for disguise in disguises:
        text = Hidden.of("1+2*{}", plain.format(0.7), disguise.format(0.7))
        given = np.array([float(formula(text.given, ca)(*point)) for point in points.T])
        np.testing.assert_allclose(given, values(text, points), atol=1e-4)
