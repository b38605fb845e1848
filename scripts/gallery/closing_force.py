"""A seal for a given closing force: its two moduli, how far it is closed, and the bead that it is closed on.

A strip of rubber, by symmetry its right half, 1 wide and 0.5 high, nu = 0.4, plane strain, is glued to a
rigid flange along its top. Its lower half, the lip, has Young's modulus 100 E_l, its upper half, the core,
100 E_c. A rigid bead is pushed against it by a distance d, without friction:

    -div sigma(u) = 0,    u = 0 on y = 0.5,    u_x = 0 on x = 0,    gap = y + u_y - d + c x^2 >= 0 on y = 0.

The design variables are E_l, E_c, d and the curvature of the bead c:

    minimise   max p
    subject to integral of p = 4    and    length of contact <= 0.45.

The length of contact is the smoothed one, the integral of p^2 / (p^2 + 0.25). The closing force is given and
the seat is narrow, so that the mean pressure is about 9 whatever the seal. The maximum has no derivative
where two nodes have the largest pressure. It is minimised exactly, as one number above all of them.

    python scripts/gallery/closing_force.py --n 8 --picture closing_force.png
    rmesh compare scripts/gallery/closing_force.toml \
        --formulations nested,mpcc --out closing_force
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from common import command_line, save
from designs import SEEDS, Designed, designed

import rmesh_nlp as rm
from rmesh_nlp.meshes import named

FORCE, LENGTH = 4.0, 0.45

BLUES = plt.get_cmap("Blues")

OBJECTIVE = "max-pressure(bottom)"

NAMES = ("start", "best")


def problem(n: int, order: int = 2) -> rm.ContactProblem:
    """Half of the seal on ``2 n`` x ``n`` squares, n even."""
    lip = rm.DesignVariable("lip", 3.0, (1.0, 10.0))
    core = rm.DesignVariable("core", 3.0, (1.0, 10.0))
    closing = rm.DesignVariable("d", 0.0147, (0.005, 0.03))
    bead = rm.DesignVariable("c", 0.1, (0.02, 0.3))
    mesh = rm.shapes.rectangle(2 * n, n, y=(0, 0.5))
    parts = {"lip": lambda x: x[1] < 0.25, "core": lambda x: x[1] > 0.25}
    return rm.ContactProblem(
        mesh=named(mesh, subdomains=parts),
        law={each.name: rm.PlaneStrain.from_young(100 * each.symbol, 0.4) for each in (lip, core)},
        dirichlet=(rm.Dirichlet("left", (0.0, None)), rm.Dirichlet("top", (0.0, 0.0))),
        obstacle=rm.Obstacle.graph("bottom", lambda x, y: closing.symbol - bead.symbol * x**2),
        motion=rm.Motion(0.0),
        design=(lip, core, closing, bead),
        constraints=(
            rm.Constraint("resultant(bottom)", (FORCE, FORCE)),
            rm.Constraint("contact-length(bottom, 0.5)", (-np.inf, LENGTH)),
        ),
        order=order,
        name="seal for a closing force",
    )


def main(n: int = 8, order: int = 2, seeds: Sequence[int | None] = SEEDS) -> Designed:
    """Design the seal from each start, and measure the gain again on finer meshes."""
    seal = designed(problem, n, order, OBJECTIVE, seeds)
    seal.show(NAMES, {"peak_pressure": "peak", "resultant": "resultant", "contact_length": "contact"})
    return seal


def draw(seal: Designed, path: Path) -> None:
    """The best seal pressed on its bead, and the pressures of both on two meshes."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained", width_ratios=(1.1, 1))
    best, design = seal.finer[0][1], seal.starts.best.design
    mesh, vertices = best.mesh, best.mesh.p.shape[1]
    x, y = mesh.p + best.displacement[:, :vertices]
    is_lip = np.isin(np.arange(mesh.t.shape[1]), mesh.subdomains["lip"]).astype(float)
    axes[0].tripcolor(x, y, mesh.t.T, facecolors=is_lip, cmap=BLUES, vmin=-0.4, vmax=1.6)
    axes[0].triplot(x, y, mesh.t.T, color="white", linewidth=0.3)
    at = np.linspace(0, 1, 101)
    height = design["d"] - design["c"] * at**2
    axes[0].fill_between(at, height, -0.08, color="0.75")
    for height, text, color in (
        (0.38, f"core, E = {100 * design['core']:.0f}", "black"),
        (0.13, f"lip, E = {100 * design['lip']:.0f}", "white"),
        (-0.05, "rigid bead", "black"),
    ):
        axes[0].text(0.03, height, text, color=color)
    axes[0].set(xlabel="x", ylabel="y", title="the best seal, closed", aspect="equal", ylim=(-0.08, 0.52))
    seal.draw_pressures(axes[1], NAMES)
    axes[1].set_xlim(0, 0.7)
    axes[1].legend(frameon=False)
    save(figure, path)


if __name__ == "__main__":
    command_line(main, 8, draw)
