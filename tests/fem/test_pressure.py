"""Objectives of contact forces: values by hand and from the forces of a contact solution, and refusals."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.discretisation import discretise
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.solving.outer import Outer
from support.contact_geometry import block_along_a_circle
from support.orders import ORDERS
from support.problems import COULOMB, LENGTH, PRESSURE, SHEAR, sliding_block, sloped_block
from support.solved import example

MU, P, F = SHEAR, PRESSURE, COULOMB


def value(problem: ContactProblem, text: str) -> float:
    """An objective at the contact solution on the given mesh."""
    outer = Outer.of(problem, text)
    return float(outer.function(np.zeros(outer.n)).value)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("level-pressure(bottom)", 0.0),
        ("resultant(bottom)", P * LENGTH),
        ("shear(bottom)", -F * P * LENGTH),
        ("contact-length(bottom, 1)", LENGTH * 9 / 10),
        ("contact-length(bottom, 1e-9)", LENGTH),
        ("peak-pressure(bottom, 1.5, 5)", 2.0**5),
        ("compliance", 0.0),  # both sides move alike
        ("area", LENGTH),
        ("square(resultant(bottom) - 4)", (P * LENGTH - 4) ** 2),
        ("square(2*area + shear(bottom) + 1e-1)", (2 * LENGTH - F * P * LENGTH + 0.1) ** 2),
        ("square(square(area - 1) - 3.5)", (1 - 3.5) ** 2),
        ("square(-area)", LENGTH**2),
        ("2*square(area-1e+0) + 0.5*resultant(bottom)", 2 + P),
    ],
)
def test_a_sliding_block_by_hand(text: str, expected: float, order: int) -> None:
    assert value(sliding_block(order), text) == pytest.approx(expected, rel=1e-9, abs=1e-10)


def test_compliance_of_a_bar_and_of_a_membrane_by_hand() -> None:
    """A bar, 2 long, under the traction 3 on its end, E = 2 mu; u = x (1 - x/2) under the source 1."""
    mesh = rm.shapes.rectangle(4, 2, x=(0, 2))
    supports = rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("bottom", (None, 0.0))
    bar = ContactProblem(
        mesh, rm.PlaneStrain(0.0, MU), supports, rm.Obstacle("top", (0.0, -1.0), 1.0),
        tractions=rm.Traction("right", (3.0, 0.0)),
    )  # fmt: skip
    assert value(bar, "compliance") == pytest.approx(3 * (3 / (2 * MU)) * 2)
    membrane = ContactProblem(
        rm.shapes.rectangle(4, 4), rm.Laplace(1.0), "left", rm.Obstacle("right", (1.0,), 9.0), order=2
    )
    assert value(membrane, "compliance") == pytest.approx(1 / 2 - 1 / 6)


PROBLEMS: dict[str, Any] = {
    "Signorini": lambda: example("6.1", 4),
    "frictionless": lambda: example("6.2", (6, 4)),
    "Tresca": lambda: example("6.3", (6, 4)),
    "sloped": sloped_block,
    "gaps along edges of a circle": block_along_a_circle,
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_sums_over_the_nodes_of_a_contact_boundary(name: str, order: int) -> None:
    problem = replace(PROBLEMS[name](), order=order)
    outer, boundary = Outer.of(problem), problem.obstacles[0].boundary
    q = 0.3 * np.random.default_rng(0).uniform(-1, 1, outer.n)
    point = outer.energy(q)
    state, weights = point.equilibrium, outer.discretisation.space.weights(outer.nodes(q))
    force, total = state.normal_force, np.sum(weights)
    pressure = force / weights
    assert np.ptp(pressure) > 0.1 * np.max(pressure) > 0
    ends = problem.mesh.p[:, problem.mesh.facets[:, problem.mesh.boundaries[boundary]]]
    length = np.sum(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=0))
    expected = {
        f"resultant({boundary})": np.sum(force),
        f"level-pressure({boundary})": weights @ (pressure - np.sum(force) / total) ** 2,
        f"contact-length({boundary}, 3)": weights @ (pressure**2 / (pressure**2 + 9)),
        f"peak-pressure({boundary}, 2, 4)": weights @ (pressure / 2) ** 4 / length,
        f"peak-pressure({boundary}, 2)": weights @ (pressure / 2) ** 8 / length,
    }
    if problem.frictional:
        expected[f"shear({boundary})"] = np.sum(state.tangential_force)
    for text, wanted in expected.items():
        found = outer.minimising(rm.objective(text)).function(q).value
        assert found == pytest.approx(wanted, rel=1e-9), text


def test_the_length_of_contact_of_the_record_is_the_limit() -> None:
    solution = rm.solve(example("6.2", (6, 4)), "fixed", objective="contact-length(contact, 1e-6)")
    record = solution.record()
    assert record["objective_value"] == pytest.approx(record["contact_length"], rel=1e-9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("level-pressure(top)", "'top' is not a contact boundary: choose from contact"),
        ("resultant(tip)", "'tip' is not a contact boundary"),
        ("shear(contact)", r"shear\(contact\): contact on 'contact' is without friction"),
        ("contact-length(contact, 0)", "reference pressure must be positive, got 0"),
        ("contact-length(contact)", r"expected contact-length\(NAME, P\)"),
        ("resultant()", r"expected resultant\(NAME\)"),
        ("level-pressure(a, b)", r"expected level-pressure\(NAME\)"),
        ("square(area - x)", "unknown objective 'x' in 'area - x'"),
        ("square()", "unknown objective ''"),
        ("square(area - inf)", "needs a finite value, got inf"),
        ("-2*square(area - 1)", "must be positive"),
    ],
)
def test_what_does_not_suit_is_said(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        value(example("6.2", (6, 3)), text)


def test_quantities_that_a_problem_does_not_have() -> None:
    block = sliding_block()
    with pytest.raises(ValueError, match="'compliance' needs a load"):
        value(replace(block, tractions=()), "compliance")
    with pytest.raises(ValueError, match="there is no energy"):
        value(block, "square(energy - 1)")
    twice = replace(block, obstacle=(rm.Obstacle("bottom"), rm.Obstacle("bottom", (0.6, 0.8), 0.1)))
    with pytest.raises(ValueError, match="'bottom' may meet 2 obstacles"):
        value(twice, "resultant(bottom)")
    membrane = replace(example("6.1", 3), obstacle=rm.Obstacle.interior(-0.1))
    with pytest.raises(ValueError, match="'contact' is not a contact boundary: choose from none"):
        value(membrane, "resultant(contact)")


def test_supports_have_no_part_in_the_shear() -> None:
    """The node in the corner is held along the foundation: what is tangential there is no friction."""
    block = sliding_block()
    held = replace(block, dirichlet=(rm.Dirichlet("top", (None, -0.02)), rm.Dirichlet("left", (0.0, None))))
    sizes = [
        sum(group.size for group in rm.objective("shear(bottom)").on(discretise(problem).fields()).groups)
        for problem in (block, held)
    ]
    assert sizes == [6, 5]
