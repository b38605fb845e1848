"""A foundation that moves in steps."""

import csv
from pathlib import Path

import numpy as np
import pytest

from rmesh_nlp.cli import app as cli
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, Obstacle, PlaneStrain, Relative
from rmesh_nlp.solving.load_path import contact_force, load_path
from rmesh_nlp.solving.solution import Solution
from support.formulations import fixed, joint

LAW = PlaneStrain(1.15e4, 0.83e4)


def block(obstacle: Obstacle, order: int = 1) -> ContactProblem:
    """A block on a fixed table, its sides free, pressed by a foundation from above."""
    return ContactProblem(
        mesh=rectangle(6, 4),
        law=LAW,
        dirichlet=(Dirichlet("bottom", (None, 0.0)), Dirichlet("left", (0.0, None))),
        obstacle=obstacle,
        motion=Motion(Relative(0.3)),
        order=order,
    )


@pytest.mark.parametrize(("order", "touching"), [(1, 7), (2, 13)])
def test_a_flat_plate_compresses_in_proportion(order: int, touching: int) -> None:
    problem = block(Obstacle.line("top", (0, 1), (0, -1)), order)
    steps = list(load_path(problem, (0.0, -0.02), 4, joint.solve, relocate="never", hold=fixed.solve))
    lam, mu = LAW.lame_lambda, LAW.lame_mu
    modulus = 4 * mu * (lam + mu) / (lam + 2 * mu)
    for step in steps:
        assert step.solution.success
        # uniform stress: the plate pushes down with modulus times strain, per unit thickness
        np.testing.assert_allclose(
            contact_force(step.solution), [0, modulus * step.moved[1]], rtol=1e-9, atol=1e-7
        )
        assert step.row()["largest_pressure"] == pytest.approx(-modulus * step.moved[1])
    assert [step.row()["touching_nodes"] for step in steps] == [touching] * 4


@pytest.mark.slow
@pytest.mark.parametrize("relocate", ["each", "once"])
def test_relocation_gains_in_every_step(relocate: str) -> None:
    problem, path = block(Obstacle.circle("top", (0.0, 3.0), 2.0)), (0.0, -0.03)
    still, moved = (
        list(load_path(problem, path, 2, joint.solve, relocate=how, hold=fixed.solve))
        for how in ("never", relocate)
    )
    assert [step.moved for step in moved] == [(0.0, -0.015), (0.0, -0.03)]
    first, last = (step.solution for step in moved)
    assert last.energy < still[-1].solution.energy
    if relocate == "each":  # the second step goes on within the move limits of the given mesh
        assert first.energy < still[0].solution.energy
        np.testing.assert_array_equal(last.problem.mesh.p, problem.mesh.p)
    else:
        np.testing.assert_array_equal(first.mesh.p, last.mesh.p)


def test_the_mesh_of_all_steps_is_relocated_for_the_last_one() -> None:
    """The foundation begins at height 1 and ends 0.03 lower: that is where ``solve`` must find it."""
    found: list[ContactProblem] = []

    def noted(problem: ContactProblem) -> Solution:
        found.append(problem)
        return joint.solve(problem)

    problem = block(Obstacle.line("top", (0, 1), (0, -1)))
    steps = list(load_path(problem, (0.0, -0.03), 3, noted, relocate="once", hold=fixed.solve))
    (one,) = found
    assert one.obstacles[0].distances(np.array([[0.5], [1.0]]))[0] == pytest.approx(-0.03)
    for step in steps:
        np.testing.assert_array_equal(step.solution.mesh.p, steps[-1].solution.mesh.p)


def test_each_step_starts_from_the_mesh_of_the_last_one() -> None:
    starts, ends = [], []

    def noted(problem: ContactProblem, start: np.ndarray | None, tolerance: float) -> Solution:
        starts.append(start)
        ends.append(joint.solve(problem, start=start, tolerance=tolerance))
        return ends[-1]

    steps = list(
        load_path(block(Obstacle.line("top", (0, 1), (0, -1))), (0.0, -0.03), 3, noted, tolerance=1e-3)
    )
    assert [step.number for step in steps] == [1, 2, 3]
    assert starts[0] is None
    for start, end in zip(starts[1:], ends, strict=False):
        np.testing.assert_array_equal(start, end.mesh.p)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"relocate": "sometimes"}, "got 'sometimes'"),
        ({"steps": 0}, "at least one step"),
        ({"obstacle": 1}, "no obstacle 1"),
        ({"relocate": "once", "hold": None}, "needs the solve without relocation"),
    ],
)
def test_a_wrong_path_is_refused(change: dict, message: str) -> None:
    given = {"by": (0.0, -0.1), "steps": 2, "solve": joint.solve, "hold": fixed.solve, **change}
    with pytest.raises(ValueError, match=message):
        list(load_path(block(Obstacle("top", (0.0, -1.0))), **given))


@pytest.mark.slow
def test_rmesh_path_writes_table_series_and_picture(tmp_path: Path) -> None:
    path, out = tmp_path / "press.toml", tmp_path / "out"
    path.write_text(
        '[mesh]\nshape = "rectangle"\nnx = 4\nny = 3\n[material]\nlaw = "plane-strain"\nyoung = 1000\n'
        'poisson = 0.3\n[dirichlet]\nbottom = ["free", 0]\nleft = [0, "free"]\n[contact]\nboundary = "top"\n'
        "circle = { centre = [0, 3], radius = 2 }\n[path]\nmove = [0, -0.02]\nsteps = 2\n"
    )
    assert cli.run(["path", str(path), "--out", str(out)]) in (0, 1)
    rows = list(csv.DictReader((out / "path.csv").open()))
    assert [row["moved_y"] for row in rows] == ["-0.01", "-0.02"]
    assert float(rows[1]["force_y"]) < float(rows[0]["force_y"]) < 0
    assert (out / "path.pvd").read_text().count("step-00") == 2
    assert (out / "path.png").stat().st_size > 5000
    path.write_text(path.read_text().replace("[path]", "[paths]"))
    assert cli.run(["path", str(path)]) == 2
