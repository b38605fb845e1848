"""When an element is valid: the one place for its least area and its least angle.

Both are constraints on the outer variables (:func:`validity`), of order one, and measures of a given mesh,
which decide what is accepted as a start and as a solution (:func:`is_valid`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from rmesh_nlp.errors import BadInputError
from rmesh_nlp.evaluation import ROUNDING, Array, Block, Expression, Index, Mask, Symmetric, cross
from rmesh_nlp.fem.assembly import Assembled
from rmesh_nlp.fem.fields import NONE, ElementGroup, constant_field
from rmesh_nlp.fem.reach import corners, least_areas
from rmesh_nlp.mapping import MeshMap
from rmesh_nlp.meshes.geometry import angles
from rmesh_nlp.optimize.constraints import Linearised
from rmesh_nlp.problem import ContactProblem, signed_areas
from rmesh_nlp.problem.body import Body


@dataclass(frozen=True)
class Validity:
    """Constraints on the elements that the move limits alone do not keep valid, as functions of q.

    ``signed area >= bound`` for each, and with a least angle theta also, at each vertex,
    ``cross(a, b) cos(theta) - dot(a, b) sin(theta) >= 0`` for its edges a and b, which is
    |a| |b| sin(angle - theta). All rows are in units of the initial area.

    Attributes
    ----------
    elements : (constrained elements,) int array
    group : ElementGroup
        One row per constrained element (four with a least angle), numbered from zero element by element.
    bound : (rows,) array
        Lower bounds of the rows.
    """

    elements: Index
    group: ElementGroup
    bound: Array
    n_q: int

    @property
    def size(self) -> int:
        """Number of rows."""
        return self.bound.size

    @cached_property
    def q(self) -> ca.MX:
        """The symbol of the outer variables in ``assembled``."""
        return ca.MX.sym("q", self.n_q)

    @cached_property
    def assembled(self) -> Assembled:
        """The rows and their derivatives as functions of ``q`` and an empty ``p``."""
        return Assembled([self.group], self.q, ca.MX(0, 1), self.size)

    def at(self, q: Array) -> Linearised:
        """The rows less their bounds, at a valid ``q``."""
        *_, value, jacobian = self.assembled.first(q, None)
        return Linearised(value - self.bound, sp.csr_array(self._blocks[0](jacobian)))

    def hessian(self, q: Array, multipliers: Array) -> sp.csc_array:
        """The Hessian of ``multipliers . rows``."""
        (values,) = self.assembled.second(q, None, np.zeros(1), multipliers)
        return self._blocks[1](values)

    @cached_property
    def _blocks(self) -> tuple[Block, Symmetric]:
        return Block(self.assembled.first.pattern), Symmetric(self.assembled.second.pattern)

    @property
    def upright_group(self) -> ElementGroup:
        """The same rows, the area not a number where the element is inverted: Ipopt shortens a step to there.

        Stiffness is divided by the area, so equilibrium can hold with inverted elements, too, and a solver
        that may violate the rows would go there and not come back.
        """

        def upright(f: Expression, rows: Expression) -> list[Expression]:
            area, *angles = ca.vertsplit(rows)
            return [f, ca.vertcat(ca.if_else(area > 0, area, type(area)(np.nan)), *angles)]

        return self.group.through(upright)

    def without_rows(self) -> Validity:
        """No rows at all, where a barrier stands in their place."""
        none = np.zeros(0, dtype=np.int64)
        return Validity(none, self.group.some(none), np.zeros(0), self.n_q)


def validity(problem: ContactProblem, free: MeshMap) -> Validity:
    """The validity rows of a problem; ValueError if the mesh as given has a smaller angle than is asked for.

    Elements whose least area over the move limits is large enough need no constraint; all that move do if a
    least angle is asked for.
    """
    triangles, motion = problem.triangles, problem.motion
    initial = signed_areas(problem.mesh.p, triangles)
    if motion.min_angle > 0:
        angle = least_angles(problem.mesh.p, triangles)
        if np.min(angle) < motion.min_angle - np.rad2deg(ROUNDING):
            raise BadInputError(
                f"min_angle is {motion.min_angle} degrees, but element {int(np.argmin(angle))} of the "
                f"initial mesh has an angle of {np.min(angle):.4g}",
                "min_angle",
            )
        moves = np.any(free.positions.index != NONE, axis=0) | _shaped(free)
        at_risk = np.flatnonzero(np.any(moves[triangles], axis=0))
    else:
        limits = corners(problem, free.positions, problem.mesh.p)
        at_risk = np.flatnonzero(least_areas(limits, triangles) < motion.min_area_fraction * initial)
    function = _rows(np.deg2rad(motion.min_angle))
    per_element = function.size1_out(1)
    rows = np.arange(per_element * at_risk.size).reshape(-1, per_element).T
    arguments = (free.positions.at(triangles[:, at_risk]), constant_field(initial[at_risk]))
    bound = np.zeros((at_risk.size, per_element))
    bound[:, 0] = motion.min_area_fraction
    return Validity(at_risk, ElementGroup(function, arguments, rows), bound.ravel(), free.n)


def area_ratios(problem: ContactProblem, nodes: Array) -> Array:
    """Signed element areas at ``nodes`` (2, nodes) over those of the mesh as given."""
    triangles = problem.triangles
    return signed_areas(nodes, triangles) / signed_areas(problem.mesh.p, triangles)


def least_area_ratio(problem: ContactProblem, nodes: Array) -> float:
    """The least of :func:`area_ratios`; not positive if an element is inverted."""
    return float(np.min(area_ratios(problem, nodes)))


def is_valid(problem: ContactProblem, nodes: Array, *, by_barrier: bool = False) -> bool:
    """Whether all elements keep the least area and angle that the motion asks for, up to ``ROUNDING``.

    With ``by_barrier`` a distortion in the objective keeps elements from degenerating: where no least
    angle is asked for they need a positive area only.
    """
    motion = problem.motion
    if not Body(problem, nodes).is_upright():
        return False
    if motion.min_angle == 0 and by_barrier:
        return True
    if least_area_ratio(problem, nodes) < motion.min_area_fraction - ROUNDING:
        return False
    angle = motion.min_angle - np.rad2deg(ROUNDING)
    return motion.min_angle == 0 or bool(np.min(least_angles(nodes, problem.triangles)) >= angle)


def least_angles(nodes: Array, triangles: NDArray) -> Array:
    """Smallest angle of each triangle in degrees."""
    return np.rad2deg(np.min(angles(nodes, triangles), axis=0))


def _rows(angle: float) -> ca.Function:
    X, area0 = ca.SX.sym("X", 2, 3), ca.SX.sym("area0")
    sides = [(X[:, (i + 1) % 3] - X[:, i], X[:, (i + 2) % 3] - X[:, i]) for i in range(3)]
    products = [cross(a, b) for a, b in sides]
    rows = [products[0]]
    if angle > 0:
        rows += [
            c * np.cos(angle) - ca.dot(*ab) * np.sin(angle) for c, ab in zip(products, sides, strict=True)
        ]
    return ca.Function("validity", [ca.vec(X), area0], [0, ca.vertcat(*(row / (2 * area0) for row in rows))])


def _shaped(free: MeshMap) -> Mask:
    """(nodes,) Whether a shape moves a node."""
    modes = free.positions.modes
    if modes is None:
        return np.zeros(free.positions.index.shape[1], dtype=bool)
    return np.any(modes.motions != 0, axis=(0, 1))
