"""Coulomb friction against a closed form and published figures.

python scripts/benchmark_coulomb.py partial       partial slip of Cattaneo and Mindlin
python scripts/benchmark_coulomb.py plate         a plate that is pressed and pushed, five published figures
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import brentq
from skfem import MeshTri

import rmesh_nlp as rm
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.contact.system import Equilibrium
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem
from rows import command_line, markdown

COEFFICIENT, RADIUS, PRESS = 0.3, 10.0, 0.19
"""Of partial slip, Young's modulus one: F, the radius of the cylinder, and the approach at which the
half-width is about one."""


def graded(first: float, fine: float, size: float, growth: float) -> Array:
    """Places from 0 to ``size``, ``first`` apart up to ``fine`` and then farther by the factor ``growth``."""
    places, step = list(np.arange(0, fine + first / 2, first)), first
    while places[-1] < size:
        step *= growth
        places.append(places[-1] + step)
    x, start = np.array(places), places[np.searchsorted(places, fine)]
    x[x > start] = start + (x[x > start] - start) * (size - start) / (x[-1] - start)
    return x


def pressed_block(n: int, shear: float, poisson: float = 0.49, order: int = 2) -> ContactProblem:
    """A block on a rigid cylinder, its top moved down and sideways; ``n`` edges over the half-width.

    The block is 24 half-widths high and 48 wide. In one of half that size pressing alone makes the ends of
    the contact slip, along 5 % of it.
    """
    x, y = graded(1 / n, 1.25, 24.0, 1.5), graded(1 / n, 0.0, 24.0, 1.5)
    mesh = MeshTri.init_tensor(np.concatenate([-x[:0:-1], x]), y)
    mesh = mesh.with_boundaries({"bottom": lambda z: z[1] == 0, "top": lambda z: z[1] == y[-1]})
    return ContactProblem(
        mesh,
        rm.PlaneStrain.from_young(1.0, poisson),
        rm.Dirichlet("top", (shear, -PRESS)),
        rm.Obstacle("bottom", offset=lambda x, y: x**2 / (2 * RADIUS), coulomb=COEFFICIENT),
        rm.Motion(None),
        order=order,
    )


@dataclass(frozen=True)
class StickZone:
    """Tangential over largest tangential force, half-widths of stick and contact, a bracket of the first.

    Stresses are means over edges. In the closed form the square of the pressure over the contact, and that of
    what the friction leaves of its bound over the part that sticks, are parabolas in x: the half-widths are
    those between the zeros of the parabolas fitted there.
    """

    load: float
    stick: float
    contact: float
    bracket: tuple[float, float]
    sets: int

    @staticmethod
    def of(model: ContactSolver) -> StickZone:
        """That of the contact solution on the mesh as given."""
        state, nodes = model.given, np.asarray(model.problem.mesh.p)
        places = model.discretisation.space.points(nodes)[0, model.contact_nodes]
        along = np.argsort(places)
        x, normal, tangential = (v[along] for v in (places, state.normal_force, state.tangential_force))
        sticks = (state.active.touching & (state.active.sliding == 0))[along]
        per_edge = model.problem.order
        ends, inner = slice(0, None, per_edge), slice(1, None, 2)

        def means(force: Array) -> Array:
            """Of stresses on edges, by the forces at their nodes."""
            total = (force[ends][:-1] + force[ends][1:]) / 2
            return np.asarray((total + (force[inner] if per_edge == 2 else 0.0)) / np.diff(x[ends]))

        middle, pressure, friction = (x[ends][:-1] + x[ends][1:]) / 2, means(normal), means(tangential)
        held = sticks[ends][:-1] & sticks[ends][1:] & (sticks[inner] if per_edge == 2 else True)
        pressed = (normal[ends][:-1] > 0) & (normal[ends][1:] > 0)
        spare = COEFFICIENT * pressure - np.abs(friction)
        first, last = np.flatnonzero(sticks)[[0, -1]]
        return StickZone(
            tangential_load(state),
            half_width(middle[held], spare[held]),
            half_width(middle[pressed], pressure[pressed]),
            ((x[last] - x[first]) / 2, (x[last + 1] - x[first - 1]) / 2),
            state.iterations,
        )

    @property
    def error(self) -> float:
        """Relative error of stick over contact, which is ``sqrt(1 - Q/(F P))``."""
        return float(self.stick / self.contact / np.sqrt(1 - self.load) - 1)


def tangential_load(state: Equilibrium) -> float:
    """Q/(F P)."""
    return float(abs(state.tangential_force.sum()) / (COEFFICIENT * state.normal_force.sum()))


def half_width(x: Array, stress: Array) -> float:
    """Half the distance of the zeros of the parabola through the squares of a stress."""
    zeros = np.roots(np.polyfit(x, stress**2, 2))
    return float(abs(zeros[0] - zeros[1]) / 2)


def partial_slip(n: int = 16) -> pd.DataFrame:
    """c/a against ``sqrt(1 - Q/(F P))`` for several Q/(F P)."""

    def excess(shear: float, load: float) -> float:
        return tangential_load(ContactSolver(pressed_block(n, shear)).given) - load

    lines = []
    for load in np.arange(1, 10) / 10:
        shear = brentq(excess, 1e-4, 0.15, args=(load,), rtol=1e-3)
        zone = StickZone.of(ContactSolver(pressed_block(n, shear)))
        low, high = (f"{value / zone.contact:.3f}" for value in zone.bracket)
        lines.append(
            {
                "Q/(F P)": f"{zone.load:.3f}",
                "c/a exact": f"{np.sqrt(1 - zone.load):.4f}",
                "computed": f"{zone.stick / zone.contact:.4f}",
                "error": f"{100 * zone.error:+.2f} %",
                "last node that sticks, next": f"{low} to {high}",
                "active sets": zone.sets,
            }
        )
    return pd.DataFrame(lines)


PLATE = {0.0: 2.86e-5, 0.00125: 2.72e-5, 0.005: 2.28e-5, 0.0075: 1.98e-5, 0.01125: 1.50e-5}
"""Slip in m at places of the lower edge in m: code_aster's test SSNV128 (V6.04.128, to 5 %), a mean of codes
after R. A. Feijoo, H. J. C. Barbosa, N. Zouain, Numerical formulations for contact problems with friction,
Journal of Theoretical and Applied Mechanics."""


def plate(n: int, order: int) -> ContactProblem:
    """Half of a square plate of 80 mm, F = 1, pressed from above by 50 and from the side by 150 MPa."""
    return ContactProblem(
        rectangle(n, n, x=(0, 0.04), y=(0, 0.04)),
        rm.PlaneStrain.from_young(1.3e11, 0.2),
        rm.Dirichlet("right", (0.0, None)),
        rm.Obstacle("bottom", coulomb=1.0),
        rm.Motion(None),
        (rm.Traction("top", (0.0, -5e7)), rm.Traction("left", (15e7, 0.0))),
        order=order,
    )


def plate_slips(problem: ContactProblem) -> Array:
    """Computed slips over published ones, at the places of ``PLATE``."""
    model = ContactSolver(problem)
    space, nodes = model.discretisation.space, np.asarray(problem.mesh.p)
    u = model.displacement.values(model.given.u)[0, : space.n_vertices]
    bottom = np.flatnonzero(nodes[1] == 0)
    along = bottom[np.argsort(nodes[0, bottom])]
    return np.interp(list(PLATE), nodes[0, along], u[along]) / np.array(list(PLATE.values()))


def plates() -> pd.DataFrame:
    """On 32 x 32 squares as in the test, and on finer ones."""
    sizes = [(32, 1), (32, 2), (64, 1), (64, 2), (128, 1)]
    lines = [(f"{n} x {n}", k, *(f"{r:.3f}" for r in plate_slips(plate(n, k)))) for n, k in sizes]
    return pd.DataFrame(lines, columns=["squares", "order", *(f"x = {1e3 * x:g} mm" for x in PLATE)])


TABLES = {
    "partial": partial_slip,
    "plate": plates,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print tables."""
    parser = command_line(__doc__)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"{', '.join(TABLES)}; default: all")
    for name in parser.parse_args(arguments).tables or TABLES:
        print(markdown(TABLES[name]()))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
