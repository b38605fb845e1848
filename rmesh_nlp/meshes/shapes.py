"""Meshes of simple shapes with named boundaries: a rectangle, and others through gmsh.

gmsh is an optional extra: ``pip install rmesh-nlp[gmsh]``.
"""

from __future__ import annotations

import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from skfem import MeshTri

from rmesh_nlp.errors import BadInputError, require
from rmesh_nlp.evaluation import Array, is_finite, is_pair
from rmesh_nlp.meshes.arrays import from_arrays
from rmesh_nlp.meshes.curves import Two
from rmesh_nlp.meshes.reading import read_mesh
from rmesh_nlp.settings import Number, check_positive

Vertex = tuple[Two, float, Two | None]
"""A place, the length of edges there, and the centre of the arc to the next one (None: a line)."""

DIAGONALS = ("rising", "falling")

LARGEST = 1e6
"""Triangles that a shape may have."""


def rectangle(
    nx: int,
    ny: int,
    *,
    x: Two = (0.0, 1.0),
    y: Two = (0.0, 1.0),
    diagonal: str = "rising",
) -> MeshTri:
    """A rectangle of cells of two triangles, with boundaries ``left``, ``right``, ``bottom``, ``top``.

    Parameters
    ----------
    nx, ny : int
        Cells along x and along y.
    x, y : tuple of float
        Ends of the rectangle, in units of length; 0 and 1 by default.
    diagonal : "rising" or "falling"
        Whether each cell is cut from lower left to upper right, as by default, or from upper left to lower
        right.
    """
    for name, n in (("nx", nx), ("ny", ny)):
        Number(least=1).check(name, n)
    for name, ends in (("x", x), ("y", y)):
        require(is_pair(ends) and ends[0] < ends[1], name, "be two increasing numbers", ends)
    _affordable(2 * nx * ny)
    require(diagonal in DIAGONALS, "diagonal", f"be one of {', '.join(DIAGONALS)}", diagonal)
    nodes = np.stack(np.meshgrid(np.linspace(*x, nx + 1), np.linspace(*y, ny + 1), indexing="ij"), axis=-1)
    number = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
    ll, lr, ul, ur = (a.ravel() for a in (number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]))
    cells = [(ll, lr, ur), (ll, ur, ul)] if diagonal == "rising" else [(ll, lr, ul), (lr, ur, ul)]
    sides = {
        "left": lambda z: z[0] == x[0],
        "right": lambda z: z[0] == x[1],
        "bottom": lambda z: z[1] == y[0],
        "top": lambda z: z[1] == y[1],
    }
    return from_arrays(nodes.reshape(-1, 2), np.hstack(cells).T, sides)


def l_shape(h: float, *, size: float = 1.0) -> MeshTri:
    """A square (-size, size)^2 without its lower right quarter, made by gmsh.

    Boundaries are ``corner``, the two edges at the re-entrant corner at the origin, and ``outer``.

    Parameters
    ----------
    h : float
        Length of edges, in units of length.
    size : float
        Half the side of the square, in units of length.
    """
    check_positive(h=h, size=size)
    s = size
    points = [(0, 0), (s, 0), (s, s), (-s, s), (-s, -s), (0, -s)]
    return polygon(points, h, {"corner": [0, 5], "outer": [1, 2, 3, 4]})


def plate_with_hole(h: float, *, size: float = 10.0, radius: float = 2.5) -> MeshTri:
    """A square (0, size)^2 with a round hole in its middle, made by gmsh.

    Boundaries are ``left``, ``right``, ``bottom``, ``top`` and ``hole``.

    Parameters
    ----------
    h : float
        Length of edges, in units of length.
    size, radius : float
        Side of the square and radius of the hole, in units of length.
    """
    check_positive(h=h, size=size, radius=radius)
    if not radius < size / 2:
        raise BadInputError(f"the hole of radius {radius} does not fit into a square of side {size}")
    _affordable(2.3 * (size / h) ** 2)

    c, r = size / 2, radius
    square: list[Vertex] = [((x, y), h, None) for x, y in ((0, 0), (size, 0), (size, size), (0, size))]
    hole: list[Vertex] = [((x, y), h, (c, c)) for x, y in ((c + r, c), (c, c + r), (c - r, c), (c, c - r))]
    sides = {"bottom": [0], "right": [1], "top": [2], "left": [3]}
    return _drawn([square, hole], {**sides, "hole": [4, 5, 6, 7]})


def half_disc(h: float, *, radius: float = 1.0, contact: float = 0.1, h_contact: float = 0.01) -> MeshTri:
    """The right half of the lower half disc with centre (0, radius), by gmsh: a quarter, by symmetry.

    The arc is cut off at the bottom by its chord of half-length ``contact``, so that contact
    nodes can slide on a straight piece; the true distance to the line y = 0 belongs into the
    obstacle, radius - sqrt(radius^2 - x^2). Boundaries are ``axis`` (x = 0), ``top`` (y = radius), ``arc``
    and ``contact``.

    Parameters
    ----------
    h, h_contact : float
        Length of edges far from the contact and at it, in units of length.
    radius, contact : float
        Radius of the disc and half-length of the chord, in units of length.
    """
    check_positive(h=h, radius=radius, contact=contact, h_contact=h_contact)
    if not contact < radius:
        raise BadInputError(f"the contact half-length {contact} must be smaller than the radius {radius}")
    _affordable(2.3 * ((radius / h) ** 2 + (contact / h_contact) ** 2))

    low, centre = radius - np.sqrt(radius**2 - contact**2), (0, radius)
    loop: list[Vertex] = [
        ((0, low), h_contact, None),
        ((contact, low), h_contact, centre),
        ((radius, radius), h, None),
        (centre, h, None),
    ]
    return _drawn([loop], {"contact": [0], "arc": [1], "top": [2], "axis": [3]})


def wedge_block(h: float, *, width: float = 4.0, height: float = 1.0, rise: float = 0.2) -> MeshTri:
    """A block whose lower edge rises by ``rise`` from its middle to both ends, like a blunt wedge.

    It is made by gmsh. Boundaries are ``left``, ``right``, ``top`` and ``wedge``, the lower edge of two
    straight pieces that meet at (width/2, 0).

    Parameters
    ----------
    h : float
        Length of edges, in units of length.
    width, height, rise : float
        In units of length; the height is that above (width/2, 0), more than the rise.
    """
    check_positive(h=h, width=width, height=height)
    if not 0 <= rise < height:
        raise BadInputError(f"the rise {rise} must be at least 0 and smaller than the height {height}")
    points = [(0, rise), (width / 2, 0), (width, rise), (width, height), (0, height)]
    return polygon(points, h, {"wedge": [0, 1], "right": [2], "top": [3], "left": [4]})


def polygon(points: list[Two], h: float, boundaries: dict[str, list[int]] | None = None) -> MeshTri:
    """A simple polygon, meshed by gmsh.

    Parameters
    ----------
    points : list of tuple of float
        Corners, counter-clockwise, in units of length.
    h : float
        Length of edges, in units of length.
    boundaries : dict of lists of int, optional
        Names, and the numbers of their edges; edge i runs from point i to the next. By default edge i is
        called ``edge-i``.
    """
    check_positive(h=h)
    if not is_finite(points) or np.shape(points)[1:] != (2,) or len(points) < 3:
        raise BadInputError(f"a polygon needs 3 or more finite points, got {points}", "points")
    if crossing := _crossing_edges(np.asarray(points, dtype=float)):
        raise BadInputError("edges {} and {} of the polygon cross".format(*crossing))
    names = boundaries or {f"edge-{i}": [i] for i in range(len(points))}
    for name, edges in names.items():
        for edge in edges:
            if not 0 <= edge < len(points):
                raise BadInputError(
                    f"the boundary {name!r} names edge {edge}; edges run to {len(points) - 1}"
                )
    _affordable(2.3 * float(np.prod(np.ptp(points, axis=0))) / h**2)
    return _drawn([[(point, h, None) for point in points]], names)


def _crossing_edges(p: Array) -> list[int]:
    """Numbers of two edges of the closed polygon through points (n, 2) that cross; empty if none do."""
    a, b = p, np.roll(p, -1, axis=0)

    def side(corner: Array) -> Array:  # (edges, edges), of which of its edges each point is on the left
        x, y = (b - a).T[:, :, None]
        return np.sign(x * (corner[:, 1] - a[:, 1:]) - y * (corner[:, 0] - a[:, :1]))

    apart = side(a) * side(b) < 0
    return np.argwhere(apart & apart.T)[:1].ravel().tolist()


def _drawn(loops: list[list[Vertex]], boundaries: dict[str, list[int]]) -> MeshTri:
    """What gmsh makes of the surface within the first loop and outside the others.

    ``boundaries`` names edges by their numbers, loop after loop. The same drawing gives the same mesh.
    """
    try:
        gmsh = import_module("gmsh")
    except (ImportError, OSError) as error:  # OSError: its library needs libGLU
        raise BadInputError(f"this shape needs gmsh: pip install rmesh-nlp[gmsh] ({error})") from error
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("shape")
        lines = [_lines(gmsh.model.geo, loop) for loop in loops]
        surface = gmsh.model.geo.addPlaneSurface([gmsh.model.geo.addCurveLoop(line) for line in lines])
        gmsh.model.geo.synchronize()
        every = [tag for line in lines for tag in line]
        for name, edges in boundaries.items():
            gmsh.model.addPhysicalGroup(1, [every[i] for i in edges], name=name)
        gmsh.model.addPhysicalGroup(2, [surface], name="body")
        gmsh.model.mesh.generate(2)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "shape.msh"
            gmsh.write(str(path))
            return read_mesh(path)
    except ValueError:
        raise
    except Exception as error:  # gmsh raises bare Exceptions
        raise BadInputError(f"gmsh cannot mesh this shape: {error}") from error
    finally:
        gmsh.finalize()


def _lines(geo: Any, loop: list[Vertex]) -> list[int]:
    sizes = {point: size for point, size, _ in loop}
    places = dict.fromkeys([*(centre for *_, centre in loop if centre), *sizes])
    tags = {(x, y): geo.addPoint(x, y, 0, sizes.get((x, y), 0.0)) for x, y in places}
    return [
        geo.addCircleArc(tags[a], tags[centre], tags[b]) if centre else geo.addLine(tags[a], tags[b])
        for (a, _, centre), (b, _, _) in zip(loop, [*loop[1:], loop[0]], strict=True)
    ]


def _affordable(triangles: float) -> None:
    if triangles > LARGEST:
        raise BadInputError(
            f"this would be a mesh of about {triangles:.4g} triangles, more than {LARGEST:.0e}"
        )
