"""Every sign of a wrong set-up is seen, and a sound problem has none."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.contact.penetration import penetrations
from rmesh_nlp.contact.setup_warnings import (
    SetupWarning,
    curve_warnings,
    penetration_warnings,
    setup_warnings,
)
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.meshes import from_arrays, named
from rmesh_nlp.meshes.curves import FITTED, Circle, fitted
from rmesh_nlp.meshes.geometry import counter_clockwise
from support.curved import disc
from support.formulations import fixed
from support.orders import ORDERS


def sound(**changes: Any) -> rm.ContactProblem:
    """A cantilever that is pressed onto a foundation and touches it with half of its lower side."""
    mesh = named(rm.shapes.rectangle(16, 4, x=(0, 4)), {"load": lambda x: (x[1] == 1) & (x[0] > 2)})
    problem = rm.ContactProblem(
        mesh=mesh,
        law=rm.PlaneStrain.from_young(21600.0, 0.3),
        dirichlet=("left",),
        obstacle=rm.Obstacle.graph("bottom", -0.05),
        motion=rm.Motion(rm.Relative(0.3)),
        tractions=(rm.Traction("load", (0.0, -57.5)),),
    )
    return replace(problem, **changes)


def signs(problem: rm.ContactProblem) -> tuple[SetupWarning, ...]:
    """All of a problem, as ``rmesh check`` prints them."""
    model = ContactSolver(problem)
    u, space = model.displacement.values(model.given.u), model.discretisation.space
    passing = penetrations(space, problem.mesh.p, u)
    return *curve_warnings(problem), *setup_warnings(model), *penetration_warnings(passing)


WRONG = {
    "overlap": {"obstacle": rm.Obstacle.graph("bottom", lambda x, y: 0.005 * x)},  # zero where it is held
    "away": {"tractions": (rm.Traction("load", (0.0, 57.5)),)},
    "open": {"obstacle": rm.Obstacle.graph("bottom", -50.0)},
    "all-touching": {"dirichlet": (rm.Dirichlet("top", (0.0, -0.1)),)},
    "unresolved": {"tractions": (rm.Traction("load", (0.0, -25.0)),)},
    "penetration": {
        "obstacle": rm.Obstacle.graph("bottom", lambda x, y: -0.05 * ca.cos(16 * ca.pi * x) - 0.1)
    },
    "large": {"law": rm.PlaneStrain.from_young(2160.0, 0.3), "obstacle": rm.Obstacle.graph("bottom", -1.0)},
    "tiny": {"law": rm.PlaneStrain.from_young(2.16e13, 0.3)},
    "locking": {"law": rm.PlaneStrain.from_young(21600.0, 0.4999)},
    "load": {"tractions": (rm.Traction("load", (0.0, lambda x, y: ca.if_else(x > 1000, 1, 0))),)},
    "idle": {
        "dirichlet": ("left", rm.Dirichlet("top", (None, 0.0))),
        "tractions": rm.Traction("load", (5.0, -1.0)),
    },
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_set_up_is_warned_of(kind: str, order: int) -> None:
    problem = sound(**WRONG[kind], order=order)
    found = {warning.kind: warning.message for warning in signs(problem)}
    if order == 2 and kind == "locking":  # nothing locks
        assert kind not in found
        return
    assert kind in found, found
    if kind in ("overlap", "penetration", "idle"):  # of the mesh as given, and of its solution
        assert found[kind] in fixed.solve(problem).record()["warnings"]
    if kind == "idle":
        assert found[kind].startswith("component 2 of the traction on 'load' has no effect")
    if kind == "tiny":
        assert set(found) == {"tiny", "open"}
        assert all("check units" in message for message in found.values())


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", ["", "6.1", "6.2", "6.3"])
def test_a_sound_problem_is_not_warned_of(name: str, order: int) -> None:
    problem = replace(rm.EXAMPLES[name]() if name else sound(), order=order)
    assert signs(problem) == ()
    assert name or fixed.solve(problem).record()["warnings"] == []


def bent_at_its_end() -> MeshTri:
    """At 4 of the 15 inner nodes of the lower side."""
    mesh = sound().mesh
    rise = np.where(mesh.p[1] == 0, 0.02 * np.maximum(mesh.p[0] - 3, 0) ** 2, 0.0)
    return replace(mesh, doflocs=mesh.p + np.stack([0 * rise, rise]))


PRESSED = {"dirichlet": (rm.Dirichlet("top", (0.0, -0.1)),)}
TOE = named(sound().mesh, {"toe": lambda x: (x[1] == 0) & (x[0] > 3.8)})


@pytest.mark.parametrize(
    ("changes", "kind"),
    [
        ({"law": rm.PlaneStress.from_young(21600.0, 0.4999)}, "locking"),
        (PRESSED | WRONG["load"], "load"),
        ({"dirichlet": ("left", "top")}, "load"),  # the only one acts where displacements are given
        ({"dirichlet": ("left", rm.Dirichlet("top", (0.0, None)))}, "idle"),
        ({"dirichlet": "left", "tractions": rm.Traction("left", (0.0, 0.0))}, "idle"),
        ({"mesh": bent_at_its_end()}, "round"),
        (
            PRESSED | {"mesh": TOE, "obstacle": rm.Obstacle.graph("toe", -0.05)},
            "all-touching",
        ),  # two nodes do
    ],
)
def test_what_resembles_a_sign_is_none(changes: dict[str, Any], kind: str) -> None:
    assert kind not in {warning.kind for warning in signs(sound(**changes))}


def test_the_gap_of_a_membrane_is_not_compared_with_its_extent() -> None:
    problem = rm.ContactProblem(
        rm.shapes.rectangle(4, 4), rm.Laplace(-1.0), "left", rm.Obstacle("bottom", (1.0,), 50.0)
    )
    (only,) = signs(problem)
    assert only.kind == "open"
    assert only.message.endswith("check units")


def test_a_round_contact_boundary_without_a_curve_is_told() -> None:
    arc, quarter = Circle((0.0, 1.0), 1.0), disc()
    rough = replace(quarter, obstacle=rm.Obstacle.graph("arc", -1.0), motion=rm.Motion(None))
    (said,) = [one.message for one in signs(rough) if one.kind == "round"]
    assert "'arc' bends at 8 of its 8 inner nodes" in said
    assert "[curves] arc = 'circle'" in said
    for right in (
        replace(rough, motion=rm.Motion(None, curves={"arc": arc})),
        quarter,
    ):  # that has a straight contact
        assert "round" not in {warning.kind for warning in signs(right)}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("depth", [0.0, 0.02])
def test_overlaps_of_a_round_body_are_measured_on_its_arcs(depth: float, order: int) -> None:
    """The foundation has the body's own radius: every node is as deep as the foundation is too small."""
    arc = Circle((0.0, 0.0), 1.0)
    mesh = from_arrays(*quarter_ring(12))
    problem = rm.ContactProblem(
        mesh,
        rm.PlaneStrain.from_young(1000.0, 0.3),
        (rm.Dirichlet("inner", (0.0, 0.0)),),
        rm.Obstacle.circle("outer", (0.0, 0.0), 1.0 - depth, inside=True),
        motion=rm.Motion(curves={"outer": arc}),
        order=order,
    )
    said = [one.message for one in signs(problem) if one.kind == "overlap"]
    n = 13 if order == 1 else 25
    assert [f"by up to {depth:.3g} at {n} of {n} nodes" in text for text in said] == [True] * (depth > 0)


def quarter_ring(n: int, ratio: float = 1.0) -> tuple[Any, ...]:
    """Nodes, triangles and edges between radii 0.8 and 1, or ellipses; n edges along each."""
    angle, grid = np.arange(n + 1) * np.pi / (2 * n), rm.shapes.rectangle(n, 1)
    column, row = np.rint(grid.p * [[n], [1]]).astype(int)
    p = (0.8 + 0.2 * row) * np.stack([np.cos(angle[column]), ratio * np.sin(angle[column])])
    names = {"inner": "bottom", "outer": "top"}
    edges = {new: grid.facets[:, grid.boundaries[old]].T for new, old in names.items()}
    return p.T, counter_clockwise(p, grid.t).T, edges


HEIGHT = rm.DesignVariable("d", 0.01, (0.0, 0.5))


@pytest.mark.parametrize(
    ("ratio", "height", "expected"),
    [
        (1.0, -1.0, FITTED),
        (0.6, -1.0, ("spline",)),
        (1.0, HEIGHT.symbol, ()),
    ],  # a circle; an ellipse; refused
)
def test_each_curve_that_is_advised_is_accepted(ratio: float, height: Any, expected: tuple[str, ...]) -> None:
    problem = rm.ContactProblem(
        from_arrays(*quarter_ring(12, ratio)),
        rm.PlaneStrain.from_young(1000.0, 0.3),
        (rm.Dirichlet("inner", (0.0, 0.0)),),
        rm.Obstacle.graph("outer", height),
        design=() if expected else (HEIGHT,),
    )
    (said,) = curve_warnings(problem)
    assert tuple(kind for kind in FITTED if repr(kind) in said.message) == expected
    for kind in expected:
        curve = fitted(problem.mesh, "outer", kind)
        there = replace(problem, motion=rm.Motion(curves={"outer": curve}))
        assert not list(curve_warnings(there))


def test_overlaps_are_those_of_the_nodes_as_they_are() -> None:
    model = ContactSolver(sound())
    lower = np.array(model.problem.mesh.p)
    lower[1, (lower[1] == 0) & (lower[0] > 0)] -= 0.06  # the foundation is 0.05 below
    found = [sign.message for sign in setup_warnings(model, nodes=lower) if sign.kind == "overlap"]
    assert len(found) == 1
    assert "by up to 0.01" in found[0]


@pytest.mark.slow
def test_what_the_given_mesh_was_warned_of_is_not_told_of_the_final_one() -> None:
    problem = sound(obstacle=rm.Obstacle.graph("bottom", lambda x, y: 0.03 * x - 0.05))
    said = rm.solve(problem, "joint").record()["warnings"]
    assert any("overlaps the body" in text for text in said)
    assert not any(text.startswith("at the end") for text in said)


def test_the_final_design_is_warned_of_as_well() -> None:
    problem = sound(
        obstacle=rm.Obstacle.graph("bottom", HEIGHT.symbol),
        motion=rm.Motion(0.0),
        dirichlet=(rm.Dirichlet("top", (0.0, 0.0)),),
        design=(HEIGHT,),
        tractions=(),
    )
    record = rm.solve(problem, "nested", objective="square(resultant(bottom) - 50000)").record()
    said = [text.removeprefix("at the end: ") for text in record["warnings"] if text.startswith("at the end")]
    assert any(f"overlaps the body by up to {record['design']['d']:.3g}" in text for text in said)
    assert any("the largest displacement" in text for text in said)
