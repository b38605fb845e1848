"""Triangles beside an arc that bulges into them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rmesh_nlp.fem.arcs import strain_energy
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import Laplace
from support.curved import HOLE, plate
from support.formulations import joint

HALF = 0.5
"""Half the angle of an arc of the unit circle. The tangents at its ends meet at the distance 1.14."""


@pytest.mark.parametrize("order", [1, 2])
def test_a_triangle_that_its_arc_folds_has_no_energy(order: int) -> None:
    """So a solver shortens its steps to there, and does not find the minus infinity behind."""
    energy = strain_energy(Laplace(), Circle((0.0, 0.0), 1.0), order)
    u = np.arange(float(energy.size1_in(2)))
    for apex, upright in ((1.3, True), (1.7, True), (1.1, False), (0.9, False)):
        found = float(energy([HALF, -HALF], [apex, 0.0], u)[0])
        assert bool(np.isfinite(found)) is upright


def test_relocation_of_order_2_beside_a_hole_is_not_lost_in_folded_triangles() -> None:
    solution = joint.solve(replace(plate({"hole": HOLE}), order=2))
    assert solution.status is Status.CONVERGED
    assert solution.gain_audited > 0.03
