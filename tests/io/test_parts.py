"""The parts of the page for analysts: what their contact carries."""

from pathlib import Path

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.assessment.contact_results import contact_results
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.fem.space import DisplacementSpace

PARTS = Path(__file__).parents[2] / "docs" / "parts"


@pytest.mark.parametrize(
    ("name", "forces"),
    [
        ("bracket", {"bottom": 148.0}),
        ("dam", {"base": 90.82e6}),
        ("o_ring", {"lower": 0.58, "upper": 0.58}),
        ("roller", {"arc": 40.0}),  # the load on its top
        ("ball", {"contact": 5.8904e7}),
        ("seal", {"lower": 151.7, "upper": 151.7, "outer": 19.5}),
        ("press_fit", {"fit": 5.859 * 40 * np.pi * 19}),  # Lamé's pressure
    ],
)
def test_part_has_the_forces_of_its_page(name: str, forces: dict[str, float]) -> None:
    """Of a page's figures, at order 2, those at order 1 are within 2 %."""
    solver = ContactSolver(rm.read_problem(PARTS / f"{name}.toml"))
    nodes, space = solver.problem.mesh.p, DisplacementSpace(solver.problem)
    found = contact_results(space, nodes, solver.system(nodes), solver.given)
    assert {on: result.normal_force for on, result in found.items()} == pytest.approx(forces, rel=0.02)
