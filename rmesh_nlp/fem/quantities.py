"""Quantities of interest: outer objectives of one's own, as densities or functions of nodes.

A quantity is written in CasADi: what it is given are symbols, and what it returns is an
expression of them. Its derivatives follow from that, and ``rmesh_nlp.verify_gradient`` tests
them. Quantities are added and weighted like numbers::

    sag = boundary_integral("top", lambda x, y, u, n: -u[1], mean=True)
    solve(problem, "nested", objective=sag + 0.01 * objective("quality"))

A quantity is minimised; a negative weight maximises it. An optimiser exploits a quadrature rule, so
integrals are taken with rules of high degree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from rmesh_nlp.errors import BadInputError, located
from rmesh_nlp.evaluation import Expression, Index
from rmesh_nlp.fem.cells import Density, Straight
from rmesh_nlp.fem.element import NO_ROWS
from rmesh_nlp.fem.fields import Fields, constant_field
from rmesh_nlp.fem.fit import fit, fit_file
from rmesh_nlp.fem.functional import Functional, Groups
from rmesh_nlp.fem.objective import Objective, Term
from rmesh_nlp.fem.pressure import (
    contact_length,
    largest_pressure,
    level_pressure,
    peak_pressure,
    resultant,
    shear,
)
from rmesh_nlp.fem.space import DisplacementSpace, outward_edges
from rmesh_nlp.meshes.geometry import members_of, node_at
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.problem.design import names_in, substituted, symbol
from rmesh_nlp.problem.switches import HIGH

__all__ = [
    "at_point",
    "body_integral",
    "boundary_integral",
    "contact_length",
    "fit",
    "fit_file",
    "largest_pressure",
    "level_pressure",
    "nodal",
    "of_design",
    "peak_pressure",
    "resultant",
    "shear",
    "square",
]


def _integral(
    on: Fields, name: str, cells: Index, degree: int, density: Density, factor: float = 1.0
) -> Groups:
    def scalar(*arguments: Expression) -> Expression:
        return _scalar(density(*arguments), name)

    return [on.integral("quantity", cells, degree, scalar, factor=factor)]


def body_integral(
    density: Callable[[Expression, Expression, Expression, Expression], Expression],
    *,
    name: str = "body integral",
    subdomain: str | None = None,
    degree: int = HIGH,
) -> Objective:
    """Integral of a density over the elements of the body, or of a subdomain.

    Parameters
    ----------
    density : function
        ``density(x, y, u, slope)`` with the position, the displacement (components,) and its
        gradient (components, 2). Elements are taken with straight sides, also beside curves.
    name : str
        What tables and messages call it.
    subdomain : str, optional
        Where it is integrated; by default in the whole body.
    degree : int
        Of the quadrature.
    """

    def quantity(on: Fields) -> Groups:
        triangles = on.problem.triangles
        if subdomain is not None:
            triangles = triangles[:, members_of("subdomain", subdomain, on.problem.mesh.subdomains)]
        return _integral(on, name, triangles, degree, density)

    return Term(name, quantity).alone


def boundary_integral(
    boundary: str,
    density: Callable[[Expression, Expression, Expression, Expression], Expression],
    *,
    name: str = "boundary integral",
    mean: bool = False,
    degree: int = HIGH,
) -> Objective:
    """Integral of a density over a named boundary, the contact boundary or another.

    Parameters
    ----------
    boundary : str
        Its name in the mesh.
    density : function
        ``density(x, y, u, n)`` with the position, the displacement and the outward unit normal (2,). Edges
        are straight, also on curves.
    name : str
        What tables and messages call it.
    mean : bool
        Whether to divide by the length of the boundary on the initial mesh.
    degree : int
        Of the quadrature.
    """

    def quantity(on: Fields) -> Groups:
        factor = 1 / boundary_length(on.problem, boundary) if mean else 1.0
        return _integral(on, name, outward_edges(on.problem, boundary), degree, density, factor)

    return Term(name, quantity).alone


def nodal(
    nodes: Sequence[int],
    function: Callable[[Expression, Expression], Expression],
    *,
    name: str = "nodal quantity",
) -> Objective:
    """A function of the positions and displacements of some vertices, at once.

    It becomes one dense block of second derivatives: meant for a few nodes.

    Parameters
    ----------
    nodes : sequence of int
        Their numbers.
    function : function
        ``function(X, u)`` with the positions (2, nodes) and displacements (components, nodes).
    name : str
        What tables and messages call it.
    """
    chosen = np.asarray(nodes, dtype=np.int64).reshape(-1, 1)

    def quantity(on: Fields) -> Groups:
        n = on.problem.n_vertices
        if chosen.size == 0 or chosen.min() < 0 or chosen.max() >= n:
            raise BadInputError(f"{name}: node numbers must lie between 0 and {n - 1}, got {list(nodes)}")
        at_nodes = Straight(chosen.size, on.problem.components, 1)
        value = at_nodes.function("quantity", _scalar(function(at_nodes.X, at_nodes.u), name))
        return [on.group(value, [on.positions.at(chosen), on.displacement.at(chosen)])]

    return Term(name, quantity).alone


def at_point(
    point: tuple[float, float],
    function: Callable[[Expression, Expression, Expression], Expression],
    *,
    name: str = "value at a point",
) -> Objective:
    """A function of the displacement at the node that is at ``point`` on the initial mesh.

    Parameters
    ----------
    point : (float, float)
        In units of length.
    function : function
        ``function(x, y, u)`` with the node's position after the relocation. A node that is not
        pinned may move away from the point.
    name : str
        What tables and messages call it.

    Raises
    ------
    ValueError
        When it meets a mesh without a node there.
    """

    def quantity(on: Fields) -> Functional:
        with located(name):
            node = node_at(on.problem.mesh, point)
        at_node = nodal([node], lambda X, u: function(X[0, 0], X[1, 0], u[:, 0]), name=name)
        return at_node.on(on)

    return Term(name, quantity).alone


def of_design(value: ca.SX, *, name: str = "design") -> Objective:
    """An expression of the symbols of design variables alone."""

    def quantity(on: Fields) -> Groups:
        design = on.positions.design
        rest = substituted(value, on.problem.numbers if design is None else {})
        names = names_in(rest)
        for variable in names:
            if design is None or variable not in design.names:
                raise BadInputError(f"{name}: {variable!r} is no design variable")
        local = design.of(names, 1) if design is not None and names else constant_field(np.zeros((1, 1)))
        symbols = ca.vertcat(*map(symbol, names)) if names else ca.SX.sym("none")
        function = ca.Function("of_design", [symbols], [rest, NO_ROWS])
        return [on.group(function, [local])]

    return Term(name, quantity).alone


def square(of: Objective, value: float = 0.0, *, name: str | None = None) -> Objective:
    """The square of what an objective lacks to a value that is wanted.

    Second derivatives stay sparse: the objective is one unknown more in the KKT model.

    Parameters
    ----------
    of : Objective
        What is to have a value.
    value : float
        What it should be.
    name : str, optional
        By default the text of both.
    """
    if not np.isfinite(value):
        raise BadInputError(f"the square of {of.text!r} needs a finite value, got {value}")

    def quantity(on: Fields) -> Functional:
        return of.on(on).then(lambda result: (result - value) ** 2)

    term = Term(
        name or f"square({of.text} - {value:g})",
        quantity,
        needs_exact=of.needs_exact,
        barrier=of.has_barrier,
        minimised_only=True,
    )
    return term.alone


def boundary_length(problem: ContactProblem, name: str) -> float:
    """Length of a named boundary on the initial mesh; a ValueError if it is none, or an interface.

    With the measure of the law, which makes it an area.
    """
    facets = members_of("boundary", name, problem.mesh.boundaries)
    if np.any(problem.mesh.f2t[1, facets] >= 0):
        raise BadInputError(f"{name!r} is an interface inside the body, not a boundary")
    return DisplacementSpace(problem).extent(problem.mesh.facets[:, facets])


def _scalar(value: Expression, name: str) -> Expression:
    value = ca.SX(value)
    if value.shape != (1, 1):
        raise BadInputError(f"{name}: the function must return one value, got one of shape {value.shape}")
    return value
