"""Re-solves next to a known solution: Newton steps, receding horizons, tables, derivatives by parameters."""

import casadi as ca
import numpy as np
import pytest

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.mpcc import MPCC, MPCCSolver, shift

STAGES, H = 12, 0.1


@pytest.fixture(scope="module")
def block():
    """A block on a floor with dry friction, pushed to a goal; p is its place, velocity and goal."""
    p, f, parts = ca.SX.sym("p", 3), 0, {name: [] for name in "xgGH"}
    place, velocity, goal = ca.vertsplit(p)
    for _ in range(STAGES):
        stage = ca.SX.sym("stage", 6)
        push, place_next, velocity_next, friction, forth, back = ca.vertsplit(stage)
        parts["x"].append(stage)
        parts["g"] += [
            place_next - place - H * velocity_next,
            velocity_next - velocity - H * (push + friction),
            velocity_next - forth + back,
        ]
        parts["G"] += [forth, back]
        parts["H"] += [1.5 + friction, 1.5 - friction]
        f += H * (0.01 * push**2 + (place_next - goal) ** 2)
        place, velocity = place_next, velocity_next
    f += 10 * (place - goal) ** 2 + velocity**2
    solver = MPCCSolver(MPCC(f=f, p=p, lbg=0, ubg=0, **parts))
    return solver, solver(0.0, p=[0, 0, 1.0])


@pytest.mark.slow
def test_parameters_that_change_sides_of_pairs_take_newton_steps_alone(block):
    solver, known = block
    for p in ([0.0, 0.0, 0.3], [0.7, 0.0, 1.0]):
        warm, cold = solver(known.x, p=p, start=known), solver(0.0, p=p)
        assert [step.phase for step in warm.history] == ["newton"]
        assert (warm.success, warm.stationarity) == (True, "S")
        assert warm.f == pytest.approx(cold.f, rel=1e-6)
        assert np.any((warm.G > 1e-6) != (known.G > 1e-6))


def test_shifted_result_starts_the_next_solve(block):
    solver, known = block
    x, duals = shift(known, STAGES)
    assert list(x[:6]) == list(known.x[6:12])
    assert list(x[-6:]) == list(known.x[-6:])
    assert list(duals.lam_G[:2]) == list(known.lam_G[2:4])
    following = solver(x, p=[*known.x[1:3], 1.0], start=duals)
    assert following.success
    assert following.x[0] == pytest.approx(known.x[6], abs=0.2)
    with pytest.raises(BadInputError, match="blocks must be a positive whole number, got 0"):
        shift(known, 0)


@pytest.mark.slow
def test_table_is_solved_in_processes(block):
    solver, known = block
    table = [[0, 0, goal] for goal in (0.9, 1.0)]
    for starts in (0.0, np.zeros((2, known.x.size))):
        ends = solver.map(starts, table, processes=2)
        assert [end.f for end in ends] == [solver(0.0, p=p).f for p in table]


def test_derivatives_by_parameters_are_those_of_differences(block):
    solver, known = block
    exact, step = solver.sensitivity(known, p=[0, 0, 1.0]), 1e-5
    assert exact.shape == (known.x.size, 3)
    for j, column in enumerate(exact.T):
        ends = [solver(known.x, p=np.eye(3)[2] + s * np.eye(3)[j], start=known).x for s in (step, -step)]
        assert column == pytest.approx((ends[0] - ends[1]) / (2 * step), abs=1e-6)
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    corner = MPCCSolver(MPCC(x, (x[0] - p) ** 2 + x[1], None, x[0], x[1], p=p))
    assert np.all(np.isnan(corner.sensitivity(corner(0.1, p=0), p=0)))  # x0 = max(p, 0) has a kink there


def test_maximum_on_a_branch_is_left_to_the_homotopy():
    """From a stationary point of f along x0 that is a maximum for the other sign of p."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    solver = MPCCSolver(MPCC(x, p * (x[0] - 1) ** 2 + x[1], None, x[0], x[1], ubx=3, p=p))
    known = solver([0.9, 0.1], p=1.0)
    turned = solver(known.x, p=-1.0, start=known)
    assert "newton" not in turned.columns()["phase"][:1]
    assert turned.f == pytest.approx(-4.0)
