"""A punch whose face is shaped so that its pressure is level.

An elastic punch, 2 wide and 1 high, E = 1000, nu = 0.3, plane strain, is glued to a rigid holder along its
top. A rigid plane that is tilted by 0.012 is pushed against its face by a distance d, without friction:

    -div sigma(u) = 0,    u = 0 on y = 1,    gap = Y(x) + u_y - d - 0.012 x >= 0 on the face.

The face is y = Y(x) = a_1 P_1(x) + ... + a_4 P_4(x) with Legendre's polynomials. The design variables are the
four amplitudes and d:

    minimise   integral of (p - mean p)^2 over the face
    subject to integral of p = 20.

A flat face carries the force on its right part alone, and its pressure has a peak of twice the mean. The
mean is prescribed, so that the best face has a level pressure: a_1 takes out the tilt, and a_2 to a_4 what
the glued top and the free sides do to the pressure.

    python scripts/gallery/level_punch.py --n 8 --picture level_punch.png
    rmesh compare scripts/gallery/level_punch.toml --formulations nested,mpcc --out level_punch
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from common import command_line, save
from designs import COLORS, SEEDS, Designed, along, designed

import rmesh_nlp as rm

FORCE, TILT = 20.0, 0.012

LEGENDRE = (
    lambda x, y: x,
    lambda x, y: (3 * x**2 - 1) / 2,
    lambda x, y: (5 * x**3 - 3 * x) / 2,
    lambda x, y: (35 * x**4 - 30 * x**2 + 3) / 8,
)

OBJECTIVE = "level-pressure(bottom)"

NAMES = ("flat", "shaped")


def problem(n: int, order: int = 2) -> rm.ContactProblem:
    """The punch on ``2 n`` x ``n`` squares."""
    push = rm.DesignVariable("d", 0.0084, (0.0, 0.03))
    shapes = [
        rm.Shape(f"a{k}", "bottom", (0.0, polynomial), (-0.02, 0.02))
        for k, polynomial in enumerate(LEGENDRE, 1)
    ]
    return rm.ContactProblem(
        mesh=rm.shapes.rectangle(2 * n, n, x=(-1, 1)),
        law=rm.PlaneStrain.from_young(1000.0, 0.3),
        dirichlet=(rm.Dirichlet("top", (0.0, 0.0)),),
        obstacle=rm.Obstacle.graph("bottom", lambda x, y: push.symbol + TILT * x),
        motion=rm.Motion(0.0),
        design=(push, *shapes),
        constraints=(rm.Constraint("resultant(bottom)", (FORCE, FORCE)),),
        order=order,
        name="level punch",
    )


def main(n: int = 8, order: int = 2, seeds: Sequence[int | None] = SEEDS) -> Designed:
    """Shape the face of the punch from each start, and measure the gain again on finer meshes."""
    punch = designed(problem, n, order, OBJECTIVE, seeds)
    punch.show(NAMES, {"objective_value": "objective", "peak_pressure": "peak", "resultant": "resultant"})
    return punch


def draw(punch: Designed, path: Path) -> None:
    """The faces, ten times as high, and their pressures on the mesh of the design and on that of h/4."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    for end, color, name in zip(punch.finer[0], COLORS, NAMES, strict=True):
        nodes = along(end)
        x, y = np.asarray(end.mesh.p)[:, nodes]
        axes[0].plot(x, 1e3 * (y - TILT * x), "o-", color=color, markersize=3, label=f"{name} face")
    axes[0].set(xlabel="x", ylabel="distance from the tilted plane [1e-3]", title="face before contact")
    punch.draw_pressures(axes[1], NAMES)
    axes[1].axhline(FORCE / 2, color="0.5", linewidth=0.8, linestyle=":", label="mean")
    for axis in axes:
        axis.legend(frameon=False)
    save(figure, path)


if __name__ == "__main__":
    command_line(main, 8, draw)
