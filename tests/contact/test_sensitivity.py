"""How contact solutions change, against difference quotients of solutions with the same active set."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from rmesh_nlp.contact.sensitivity import weakly_active
from rmesh_nlp.contact.system import ActiveSet, ContactSystem, Equilibrium
from rmesh_nlp.optimize.status import Status


def spring(gap: float, normal: float, slip: float, tangential: float, **changes: Any) -> tuple[Any, Any]:
    """One node that has moved by 2, under a force of 8, the units, with a friction bound of 4."""
    system = ContactSystem(
        stiffness=sp.csc_array(10.0 * np.eye(4)),
        load=np.array([8.0, 0.0, 0.0, 0.0]),
        constant=0.0,
        normals=sp.csr_array(np.array([[0.0, 1.0, 0.0, 0.0]])),
        tangents=sp.csr_array(np.array([[0.0, 0.0, 1.0, 0.0]])),
        offset=np.array([gap + 1.0]),
        slip_bound=np.array([4.0]),
        **changes,
    )
    state = Equilibrium(
        u=np.array([2.0, -1.0, slip, 0.0]),
        energy=0.0,
        normal_force=np.array([normal]),
        tangential_force=np.array([tangential]),
        active=ActiveSet(np.array([True]), np.zeros(1, dtype=np.int8)),
        status=Status.CONVERGED,
        iterations=1,
    )
    return system, state


WEAK = [
    (0.0, 0.0, 1.0, 4.0),  # touches without a force
    (1e-6, 4e-6, 1.0, 4.0),  # half a millionth of the units
    (-1e-6, -4e-6, 1.0, 4.0),
    (0.0, 5.0, 0.0, 4.0),  # rests at the bound of friction
    (0.0, 5.0, 1e-6, -4.0 + 4e-6),
    (0.0, 5.0, -1e-6, 4.0 - 4e-6),
]
STRICT = [
    *((gap, 0.0, 1.0, 4.0) for gap in (4e-6, -4e-6, 1.0)),  # open
    *((0.0, force, 1.0, 4.0) for force in (16e-6, -16e-6)),  # pressed
    *((0.0, 5.0, slip, 4.0) for slip in (4e-6, -4e-6)),  # slides
    *((0.0, 5.0, 0.0, friction) for friction in (4.0 - 16e-6, 0.0)),  # sticks
    (1.0, 0.0, 1.0, 0.0),
]


@pytest.mark.parametrize("values", [*WEAK, *STRICT])
def test_strict_complementarity_fails_where_two_things_vanish_at_once(values: Any) -> None:
    assert bool(weakly_active(*spring(*values))[0]) == (values in WEAK)


def test_friction_counts_only_where_it_may_act_and_a_body_at_rest_where_it_touches() -> None:
    at_the_bound = (0.0, 5.0, 0.0, 4.0)
    for acts in (True, False):
        assert weakly_active(*spring(*at_the_bound, frictional=np.array([acts])))[0] == acts
    # half of a contact force of 5 stands beside the bound of 4
    assert weakly_active(*spring(0.0, 5.0, 0.0, 6.5, coulomb=np.array([0.5])))[0]
    system, state = spring(*at_the_bound)
    assert not weakly_active(replace(system, slip_bound=np.zeros(0)), state)[0]
    # without any displacement the gap itself tells: no length is there to divide by
    rest = replace(spring(0.0, 0.0, 1.0, 4.0)[1], u=np.zeros(4))
    for gap, weak in ((0.0, True), (1e-9, False)):
        alone = replace(system, offset=np.full(1, gap), slip_bound=np.zeros(0))
        assert weakly_active(alone, rest)[0] == weak
