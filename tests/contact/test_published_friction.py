"""Coulomb friction against the closed form of partial slip and published slips of a plate."""

import numpy as np
import pytest
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.shapes import rectangle

COEFFICIENT, RADIUS, PRESS, EDGE = 0.3, 10.0, 0.19, 1 / 8
"""Of partial slip, Young's modulus one: F, the radius of the cylinder, the approach at which the half-width
of the contact is about one, and the length of its edges."""


def graded(fine: float, size: float) -> Array:
    """Places from 0 to ``size``, ``EDGE`` apart up to ``fine`` and then farther."""
    places, step = list(np.arange(0, fine + EDGE / 2, EDGE)), EDGE
    while places[-1] < size:
        step *= 1.5
        places.append(places[-1] + step)
    x, start = np.array(places), places[np.searchsorted(places, fine)]
    x[x > start] = start + (x[x > start] - start) * (size - start) / (x[-1] - start)
    return x


def pressed_block(shear: float) -> rm.ContactProblem:
    """A block on a rigid cylinder, its top moved down and sideways.

    It is 24 half-widths high and 48 wide: in one of half that size pressing alone makes the ends of the
    contact slip, along 5 % of it.
    """
    x, y = graded(1.25, 24.0), graded(0.0, 24.0)
    mesh = MeshTri.init_tensor(np.concatenate([-x[:0:-1], x]), y)
    mesh = mesh.with_boundaries({"bottom": lambda z: z[1] == 0, "top": lambda z: z[1] == y[-1]})
    return rm.ContactProblem(
        mesh,
        rm.PlaneStrain.from_young(1.0, 0.49),
        rm.Dirichlet("top", (shear, -PRESS)),
        rm.Obstacle("bottom", offset=lambda x, y: x**2 / (2 * RADIUS), coulomb=COEFFICIENT),
        rm.Motion(None),
        order=2,
    )


def half_width(x: Array, stress: Array) -> float:
    """Half the distance of the zeros of the parabola through the squares of a stress."""
    zeros = np.roots(np.polyfit(x, stress**2, 2))
    return float(abs(zeros[0] - zeros[1]) / 2)


@pytest.mark.parametrize("shear", [0.03, 0.06])
def test_partial_slip_is_that_of_cattaneo_and_mindlin(shear: float) -> None:
    """Stick over contact is sqrt(1 - Q/(F P)), to 2 % on 516 nodes; a bracket of its end is an edge wide.

    In the closed form the squares of the pressure, and of what friction leaves of its bound where the block
    sticks, are parabolas in x. They are fitted to means of stresses over edges.
    """
    model = ContactSolver(pressed_block(shear))
    state, nodes = model.given, np.asarray(model.problem.mesh.p)
    places = model.discretisation.space.points(nodes)[0, model.contact_nodes]
    along = np.argsort(places)
    x, normal, tangential = (v[along] for v in (places, state.normal_force, state.tangential_force))
    sticks = (state.active.touching & (state.active.sliding == 0))[along]
    load = abs(tangential.sum()) / (COEFFICIENT * normal.sum())
    assert 0.2 < load < 0.8

    def means(force: Array) -> Array:
        return np.asarray(((force[:-1:2] + force[2::2]) / 2 + force[1::2]) / np.diff(x[::2]))

    middle, pressure, friction = (x[:-1:2] + x[2::2]) / 2, means(normal), means(tangential)
    held = sticks[:-1:2] & sticks[1::2] & sticks[2::2]
    pressed = (normal[:-1:2] > 0) & (normal[2::2] > 0)
    contact = half_width(middle[pressed], pressure[pressed])
    stick = half_width(middle[held], (COEFFICIENT * pressure - np.abs(friction))[held])
    assert stick / contact == pytest.approx(np.sqrt(1 - load), rel=0.02)
    first, last = np.flatnonzero(sticks)[[0, -1]]
    low, high = (x[last] - x[first]) / 2, (x[last + 1] - x[first - 1]) / 2
    assert low - EDGE < np.sqrt(1 - load) * contact < high + EDGE


PLATE = {0.0: 2.86e-5, 0.00125: 2.72e-5, 0.005: 2.28e-5, 0.0075: 1.98e-5, 0.01125: 1.50e-5}
"""Slip in m at places of the lower edge in m: code_aster's test SSNV128 (V6.04.128, to 5 %), a mean of codes
after R. A. Feijoo, H. J. C. Barbosa, N. Zouain, Numerical formulations for contact problems with friction,
Journal of Theoretical and Applied Mechanics."""


def test_slips_of_a_plate_are_the_published_ones() -> None:
    """Half of a square plate of 80 mm, F = 1, pressed from above by 50 and from the side by 150 MPa.

    Within the 5 % of their source, and at the first four places within the rounding of three digits.
    """
    problem = rm.ContactProblem(
        rectangle(32, 32, x=(0, 0.04), y=(0, 0.04)),
        rm.PlaneStrain.from_young(1.3e11, 0.2),
        rm.Dirichlet("right", (0.0, None)),
        rm.Obstacle("bottom", coulomb=1.0),
        rm.Motion(None),
        (rm.Traction("top", (0.0, -5e7)), rm.Traction("left", (15e7, 0.0))),
    )
    model, nodes = ContactSolver(problem), np.asarray(problem.mesh.p)
    u = model.displacement.values(model.given.u)[0]
    bottom = np.flatnonzero(nodes[1] == 0)
    along = bottom[np.argsort(nodes[0, bottom])]
    slips = np.interp(list(PLATE), nodes[0, along], u[along]) / np.array(list(PLATE.values()))
    np.testing.assert_allclose(slips, 1.0, atol=0.05)
    np.testing.assert_allclose(slips[:4], 1.0, atol=0.005)
