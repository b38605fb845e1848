"""Foundations that move under a force, or by a given displacement."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.objective_text import parse_objective
from rmesh_nlp.io.vtu import fields_of
from rmesh_nlp.models.reduced_model import ReducedObjective
from rmesh_nlp.problem.contact_problem import locally_refined
from support.taylor import taylor_order

FORCE = 500.0
PUNCH = rm.Obstacle("top", (0.0, -1.0))
ROLLER = rm.Obstacle.circle("top", (1.05, 2.02), 1.0)
TOOLS = {
    "punch": replace(PUNCH, force=(0.0, -FORCE)),
    "roller": replace(ROLLER, force=(0.0, -FORCE)),
    "free roller": replace(ROLLER, force=(0.0, -FORCE), move="xy"),
    "along edges": replace(ROLLER, force=(0.0, -FORCE), gap="edge"),
    "rubbing": replace(rm.Obstacle.circle("top", (1.05, 2.02), 1.0, friction=80.0), force=(0.0, -FORCE)),
    "leaning": replace(rm.Obstacle.circle("top", (1.05, 2.02), 1.0, coulomb=0.4), force=(60.0, -FORCE)),
}


def pressed(
    tool: rm.Obstacle | tuple[rm.Obstacle, ...], n: tuple[int, int] = (8, 4), **changes: Any
) -> rm.ContactProblem:
    """A block 2 long and 1 high on its bottom, under a tool."""
    mesh = rm.shapes.rectangle(*n, x=(0.0, 2.0))
    law = rm.PlaneStrain.from_young(young=1e4, poisson=0.3)
    return rm.ContactProblem(mesh, law, "bottom", tool, **changes)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", TOOLS)
def test_forces_balance_at_the_tool(name: str, order: int) -> None:
    tool = TOOLS[name]
    solution = rm.solve(pressed(tool, order=order), "fixed")
    assert solution.success
    moves, found = np.array(tool.moves), solution.tools["top"]
    balance = np.array(found["force"]) - np.array(tool.force)
    np.testing.assert_allclose(balance[moves], 0, atol=1e-9 * FORCE)
    assert np.all(np.array(found["displacement"])[~moves] == 0)
    assert found["displacement"][1] < 0
    assert solution.record()["tools"] == solution.tools
    if order == 1 and tool.gap == "node":  # it is drawn where it ends
        assert np.nanmin(fields_of(solution).final.gap) == pytest.approx(0, abs=1e-12)


@pytest.mark.slow
def test_on_another_mesh_the_given_one_is_drawn_with_its_tool_where_it_ended() -> None:
    problem = pressed(TOOLS["roller"], motion=rm.Motion(0.01), order=1)
    fields = fields_of(rm.solve(problem, "joint", accuracy=0.02))
    assert np.nanmin(fields.given.gap) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", ["punch", "roller", "free roller", "along edges"])
def test_no_other_place_of_the_tool_has_less_energy(name: str, order: int) -> None:
    tool = TOOLS[name]
    problem = pressed(tool, (4, 2), order=order)
    solution = rm.solve(problem, "fixed")
    force, found = np.array(tool.force), np.array(solution.tools["top"]["displacement"])

    def energy(d: np.ndarray) -> float:
        still = replace(tool, force=None, move=None, displacement=tuple(d))
        return ContactSolver(replace(problem, obstacle=still)).given.energy - float(force @ d)

    assert energy(found) == pytest.approx(solution.energy, rel=1e-12)
    for step in np.eye(2)[np.array(tool.moves)]:
        around = [energy(found + h * step) for h in (-2e-3, 2e-3)]
        assert min(around) > solution.energy


@pytest.mark.slow
@pytest.mark.parametrize(("name", "order"), [("rubbing", 1), ("roller", 2)])
def test_formulations_agree(name: str, order: int) -> None:
    problem = pressed(TOOLS[name], n=(4, 2), order=order, motion=rm.Motion(delta=0.03))
    ends = [rm.solve(problem, formulation) for formulation in ("nested", "joint", "mpcc")]
    assert all(end.success for end in ends)
    gain = ends[0].energy_initial - ends[0].energy
    assert gain > 0
    for end in ends[1:]:
        assert end.energy == pytest.approx(ends[0].energy, abs=1e-6 * gain)


@pytest.mark.parametrize("objective", ["energy", "compliance"])
@pytest.mark.parametrize("name", ["free roller", "along edges", "rubbing"])
def test_gradient(name: str, objective: str) -> None:
    outer = rm.Outer.of(pressed(TOOLS[name], n=(4, 2), motion=rm.Motion(delta=0.08)))
    function = outer.energy
    if objective != "energy":
        function = ReducedObjective(outer.energy, parse_objective(objective))
    rng = np.random.default_rng(0)
    q, d = 0.3 * rng.uniform(-1, 1, outer.n), rng.uniform(-1, 1, outer.n)
    assert taylor_order(function, q, d) > 1.9


@pytest.mark.slow
def test_radius_is_a_design_variable() -> None:
    radius = rm.DesignVariable("r", bounds=(0.3, 2.0), start=1.0)
    tool = rm.Obstacle.circle("top", (1.05, 1.02 + radius.symbol), radius.symbol)
    problem = pressed(replace(tool, force=(0.0, -FORCE)), motion=rm.Motion(delta=0), design=radius)
    solution = rm.solve(problem, "nested", objective="max-pressure(top)")
    assert solution.success
    assert solution.design["r"] == pytest.approx(2.0)  # the wider, the less pressure
    assert solution.tools["top"]["force"][1] == pytest.approx(-FORCE, rel=1e-9)


@pytest.mark.slow
def test_hertz_line_contact() -> None:
    """K. L. Johnson, Contact Mechanics, 4.2: a^2 = 4 F R / (pi E*), p_0 = 2 F / (pi a)."""
    force, young, poisson, radius = 10.0, 1e4, 0.3, 1.0
    a = np.sqrt(4 * force * radius * (1 - poisson**2) / (np.pi * young))
    mesh = rm.shapes.rectangle(8, 8, x=(-1.0, 1.0), y=(-2.0, 0.0))
    tool = replace(rm.Obstacle.circle("top", (0.0, radius), radius), force=(0.0, -force))
    law = rm.PlaneStrain.from_young(young=young, poisson=poisson)
    problem = rm.ContactProblem(mesh, law, "bottom", tool, order=2)
    for width in a * 2.0 ** np.arange(4, -1, -1):
        near = np.hypot(*problem.mesh.p[:, problem.mesh.t].mean(axis=1)) < 2 * width
        problem = locally_refined(problem, np.flatnonzero(near))
    solution = rm.solve(problem, "fixed")
    (contact,) = solution.contact.values()
    assert contact["peak_pressure"] == pytest.approx(2 * force / (np.pi * a), rel=0.01)
    assert contact["contact_length"] == pytest.approx(2 * a, rel=0.03)


def test_body_between_two_foundations() -> None:
    mesh, law = rm.shapes.rectangle(4, 4), rm.PlaneStrain.from_young(young=1e4, poisson=0.3)
    both = rm.Obstacle("bottom"), TOOLS["punch"]
    middle = rm.Dirichlet("left", (0.0, None))
    solution = rm.solve(rm.ContactProblem(mesh, law, middle, both), "fixed")
    assert solution.contact["bottom"]["normal_force"] == pytest.approx(FORCE)
    strain = FORCE * (1 - 0.3**2) / 1e4  # uniform
    assert solution.tools["top"]["displacement"][1] == pytest.approx(-strain)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_two_tools_on_one_boundary_and_a_corner_that_is_held(order: int) -> None:
    """Rows that share tools still have a basis, and those of tools alone a stand-off."""
    tools = tuple(
        replace(rm.Obstacle.circle("top", (x, 2.0), 1.0), force=(0.0, -FORCE)) for x in (0.75, 1.25)
    )
    held = replace(pressed(tools[0], order=order), dirichlet=("bottom", "left"))
    for problem in (pressed(tools, order=order), held):
        solution = rm.solve(problem, "fixed")
        assert solution.success
        for tool in solution.tools.values():
            assert tool["force"][1] == pytest.approx(-FORCE, rel=1e-9)


def test_cylinder_under_a_punch() -> None:
    law = rm.Axisymmetric.from_young(young=1e4, poisson=0.3)
    foot = rm.Dirichlet("bottom", (None, 0.0))
    problem = rm.ContactProblem(rm.shapes.rectangle(4, 4), law, foot, TOOLS["punch"])
    solution = rm.solve(problem, "fixed")
    assert solution.tools["top"]["displacement"][1] == pytest.approx(-FORCE / (np.pi * 1e4))
    with pytest.raises(rm.BadInputError, match="moves along y, the axis, only"):
        replace(problem, obstacle=replace(ROLLER, force=(0.0, -FORCE), move="xy"))


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_bounds_of_a_round_tool(order: int) -> None:
    """Its force has a moment about it: that of pressure is larger than F."""
    found = rm.solve(pressed(TOOLS["roller"], order=order), "fixed", certify=True).certificate
    fine = rm.solve(pressed(TOOLS["roller"], (16, 8), order=2), "fixed", audit=False)
    assert found.guaranteed_lower
    assert found.guaranteed_upper
    for name, value in (
        ("resultant(top)", fine.contact["top"]["normal_force"]),
        ("tool_y(top)", fine.tools["top"]["displacement"][1]),
    ):
        bounds = found.bounds[name]
        assert bounds.guaranteed
        assert bounds.lower <= value <= bounds.upper
        assert value != pytest.approx(FORCE, rel=1e-5)


def test_given_displacement_has_bounds() -> None:
    moved = replace(PUNCH, displacement=(0.0, -0.01))
    solution = rm.solve(pressed(moved), "fixed", certify=True)
    assert solution.certificate.guaranteed_lower
    assert solution.certificate.lower <= solution.energy <= solution.certificate.upper + 1e-9
    assert solution.tools["top"]["force"][1] < 0


REFUSED = {
    "not meet the body in the direction of its force": lambda: ContactSolver(
        pressed(replace(PUNCH, force=(0.0, FORCE)))
    ),
    "translation of the tool on 'top'": lambda: pressed(replace(PUNCH, force=(0.0, -FORCE), move="xy")),
    "meets one such node at most": lambda: replace(
        pressed(TOOLS["roller"]), dirichlet=("bottom", "left", "right")
    ),
    "can be moved along its normal only": lambda: pressed(
        replace(rm.Obstacle.circle("top", (1.0, 2.0), 1.0, friction=1.0), displacement=(0.0, -0.1))
    ),
    "force must act along y": lambda: replace(PUNCH, force=(1.0, -1.0), move="y"),
    "force must be two finite numbers": lambda: replace(PUNCH, force=(1.0,)),
    "displacement must not come with a force": lambda: replace(TOOLS["punch"], displacement=(0, 0)),
    "move must come with a force": lambda: replace(PUNCH, move="x"),
    "two displacement components": lambda: replace(rm.Obstacle("top", (1.0,)), force=(0.0, -1.0)),
}


@pytest.mark.parametrize("said", REFUSED)
def test_refused(said: str) -> None:
    with pytest.raises(rm.BadInputError, match=said):
        REFUSED[said]()


@pytest.mark.slow
def test_shaft_that_is_all_that_holds_a_ring_has_the_pressure_of_lame() -> None:
    a, b, n = 17.5, 35.0, 4
    grid = rm.shapes.rectangle(n, 6 * n, x=(a, b), y=(-np.pi / 2, np.pi / 2))
    (r, t), names = grid.p, {"axis": ("bottom", "top"), "bore": ("left",), "outside": ("right",)}
    facets = {name: np.concatenate([grid.boundaries[each] for each in of]) for name, of in names.items()}
    mesh = replace(grid, doflocs=np.stack([r * np.cos(t), r * np.sin(t)]), _boundaries=facets)
    curves = {name: rm.Circle((0.0, 0.0), radius) for name, radius in (("bore", a), ("outside", b))}
    law, shaft = rm.PlaneStress.from_young(1.0, 0.3), rm.Obstacle.circle("bore", (0, 0), a + 0.1)
    given, motion = rm.Dirichlet("axis", (0.0, None)), rm.Motion(0.0, curves=curves)
    solution = rm.solve(rm.ContactProblem(mesh, law, given, shaft, motion, order=2), "fixed")
    lame = 0.1 / (a * ((b**2 + a**2) / (b**2 - a**2) + 0.3))
    assert solution.contact["bore"]["normal_force"] / (np.pi * a) == pytest.approx(lame, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 80.0])
def test_supports_that_move_the_other_way_stand_for_a_tool_that_moves(friction: float) -> None:
    tool, down = replace(PUNCH, friction=friction), (0.0, -0.01)
    given = rm.solve(pressed(replace(tool, displacement=down)), "fixed").contact["top"]
    other = replace(pressed(tool), dirichlet=(rm.Dirichlet("bottom", (0.0, 0.01)),))
    assert rm.solve(other, "fixed").contact["top"]["force_y"] == pytest.approx(given["force_y"], rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_by_the_shape_of_a_tool_under_a_force(order: int) -> None:
    radius, slope = rm.DesignVariable("R", 2.0, (0.5, 8.0)), rm.DesignVariable("s", 0.05, (-0.3, 0.3))
    of_radius = rm.Obstacle.circle("top", (0.9, 1 + radius.symbol), radius.symbol)
    of_slope = rm.Obstacle("top", (0.0, -1.0), lambda x, y: slope.symbol * x)
    for tool, variable in ((of_radius, radius), (of_slope, slope)):
        tool = replace(tool, force=(0.0, -FORCE))
        outer = rm.Outer.of(pressed(tool, order=order, motion=rm.Motion(0.0), design=variable))
        function = ReducedObjective(outer.energy, parse_objective("mean(right, ux)"))
        q, d = np.zeros(outer.n), np.full(outer.n, 1e-5)
        change = (function(q + d).value - function(q - d).value) / 2
        assert function(q).gradient @ d == pytest.approx(change, rel=1e-6)
        assert change != 0
