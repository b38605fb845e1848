"""Parts as analysts bring them: a gmsh file and a problem file each, solved and drawn.

``two_holes``    a plate with two holes, its lower side on a flat foundation
``rounded_punch``  right half of a punch with a rounded corner, held by symmetry and contact alone
``disc_in_cup``  half of a disc in a round cup of larger radius: a curve with its own normal
``two_jaws``     a block pressed between a flat and a curved foundation

Every part is written as ``NAME.msh`` and ``NAME.toml`` into a folder, read back as a user's file would be,
checked for signs of a wrong set-up, solved, and drawn before and after:

    python scripts/gallery/own_parts.py --folder parts
    rmesh check parts/two_jaws.toml
    rmesh compare parts/two_jaws.toml
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from support.formulations import joint
from rmesh_nlp.contact.setup_warnings import setup_warnings
from rmesh_nlp.io.problem_file import load_problem
from rmesh_nlp.report.before_after import write_pictures
from rmesh_nlp.solving.solution import Solution

STEEL = 'law = "plane-strain"\nyoung = 210000.0\npoisson = 0.3'
"""In MPa."""

REST = '\n[motion]\ndelta = { relative = 0.3 }\n\n[units]\nlength = "mm"\nforce = "N"\n'


def two_holes(gmsh: Any, h: float) -> str:
    """Plate 20 x 10 mm with two holes of radius 2 mm, clamped on the left, pressed down on the right."""
    occ = gmsh.model.occ
    plate = occ.addRectangle(0, 0, 0, 20, 10)
    holes = [occ.addDisk(x, 5, 0, 2, 2) for x in (6, 14)]
    occ.cut([(2, plate)], [(2, hole) for hole in holes])
    occ.synchronize()
    _name_edges(gmsh, {"left": (0, None), "bottom": (None, 0), "top": (None, 10)})
    gmsh.option.setNumber("Mesh.MeshSizeMax", 1.6 * h)
    return """
[boundaries]
load = "y > 9.99 and x > 10"

[dirichlet]
left = [0, 0]

[tractions]
load = [0, -600]

[contact]
boundary = "bottom"
height = -0.02
"""


def rounded_punch(gmsh: Any, h: float) -> str:
    """Half width 5 mm, height 8 mm, corner radius 2 mm; the top is loaded, the floor is y = 0."""
    geo = gmsh.model.geo
    points = [(0, 0), (3, 0), (3, 2), (5, 2), (5, 8), (0, 8)]
    sizes = [0.25 * h, 0.15 * h, h, h, h, h]
    tags = [geo.addPoint(x, y, 0, size) for (x, y), size in zip(points, sizes, strict=True)]
    lines = [
        geo.addLine(tags[0], tags[1]),
        geo.addCircleArc(tags[1], tags[2], tags[3]),
        *(geo.addLine(tags[i], tags[i + 1]) for i in (3, 4)),
        geo.addLine(tags[5], tags[0]),
    ]
    geo.addPlaneSurface([geo.addCurveLoop(lines)], 1)
    geo.synchronize()
    for name, chosen in {"foot": lines[:2], "top": [lines[3]], "axis": [lines[4]]}.items():
        gmsh.model.addPhysicalGroup(1, chosen, name=name)
    gmsh.model.addPhysicalGroup(2, [1], name="body")
    return """
[dirichlet]
axis = "symmetry"

[tractions]
top = [0, -200]

[contact]
boundary = "foot"
line = { point = [0, 0], normal = [0, 1] }
"""


def disc_in_cup(gmsh: Any, h: float) -> str:
    """Right half of the lower half of a disc of radius 10 mm in a cup of radius 11 mm."""
    geo = gmsh.model.geo
    points = [(0, 0), (0, -10), (10, 0)]
    sizes = [h, 0.12 * h, h]
    centre, low, right = (geo.addPoint(x, y, 0, size) for (x, y), size in zip(points, sizes, strict=True))
    lines = [geo.addLine(centre, low), geo.addCircleArc(low, centre, right), geo.addLine(right, centre)]
    geo.addPlaneSurface([geo.addCurveLoop(lines)], 1)
    geo.synchronize()
    for name, line in zip(("axis", "arc", "top"), lines, strict=True):
        gmsh.model.addPhysicalGroup(1, [line], name=name)
    gmsh.model.addPhysicalGroup(2, [1], name="body")
    return """
[dirichlet]
axis = "symmetry"

[tractions]
top = [0, -150]

[contact]
boundary = "arc"
circle = { centre = [0, 1], radius = 11, inside = true }
"""


def two_jaws(gmsh: Any, h: float) -> str:
    """A block 20 x 6 mm on a flat jaw with friction, pushed up at its right end against a curved one."""
    block = gmsh.model.occ.addRectangle(0, 0, 0, 20, 6)
    assert block
    gmsh.model.occ.synchronize()
    _name_edges(gmsh, {"left": (0, None), "right": (20, None), "bottom": (None, 0), "top": (None, 6)})
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    return """
[dirichlet]
left = [0, 0]

[boundaries]
end = "y < 0.01 and x > 16"
jaw = "y < 0.01 and x < 12"

[tractions]
end = [0, 250]
top = [0, -20]

[[contact]]
boundary = "jaw"
line = { point = [0, 0], normal = [0, 1] }
friction = 5

[[contact]]
boundary = "top"
curve = "6.005 + 0.0005*(x - 14)**2 - y"
gap = "edge"
"""


PARTS: dict[str, Callable[[Any, float], str]] = {
    "two_holes": two_holes,
    "rounded_punch": rounded_punch,
    "disc_in_cup": disc_in_cup,
    "two_jaws": two_jaws,
}


def write(name: str, folder: Path, h: float = 1.0) -> Path:
    """Write mesh and problem file of a part; returns the latter."""
    gmsh = import_module("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add(name)
        rest = PARTS[name](gmsh, h)
        gmsh.model.mesh.generate(2)
        folder.mkdir(parents=True, exist_ok=True)
        gmsh.write(str(folder / f"{name}.msh"))
    finally:
        gmsh.finalize()
    path = folder / f"{name}.toml"
    path.write_text(f'[mesh]\nfile = "{name}.msh"\n\n[material]\n{STEEL}\n{rest}{REST}')
    return path


def _name_edges(gmsh: Any, places: dict[str, tuple[float | None, float | None]]) -> None:
    """Name the straight edges that lie on x or y = a number; the body is the surface."""
    groups: dict[str, list[int]] = {}
    for _, curve in gmsh.model.getEntities(1):
        low, high = (gmsh.model.getBoundingBox(1, curve)[k : k + 2] for k in (0, 3))
        for name, place in places.items():
            if any(
                at is not None and abs(low[k] - at) < 1e-5 and abs(high[k] - at) < 1e-5
                for k, at in enumerate(place)
            ):
                groups.setdefault(name, []).append(curve)
    for name, curves in groups.items():
        gmsh.model.addPhysicalGroup(1, curves, name=name)
    gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntities(2)], name="body")


def main(folder: Path, h: float = 1.0, *, pictures: bool = True) -> dict[str, Solution]:
    """Write, check, solve and draw every part."""
    solutions = {}
    for name in PARTS:
        problem = load_problem(write(name, folder, h))
        for warning in setup_warnings(problem):
            print(f"{name}: warning: {warning.message}")
        solution = solutions[name] = joint.solve(problem)
        touching = int((solution.pressure > 0).sum())
        print(
            f"{name}: {problem.mesh.p.shape[1]} nodes, energy {solution.energy_initial:.6g} -> "
            f"{solution.energy:.6g}, {touching} nodes touch, peak pressure {solution.pressure.max():.4g} MPa"
        )
        if pictures:
            write_pictures(solution, folder / name)
    return solutions


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, default=Path("results/own_parts"))
    parser.add_argument("--h", type=float, default=1.0, help="edge length in mm far from the contact")
    chosen = parser.parse_args()
    main(chosen.folder, chosen.h)
