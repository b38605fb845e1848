"""Identification of a modulus, a coefficient of friction and a gap from a displacement with noise.

A slab, 4 long and 1 high, nu = 0.3, plane strain, is fixed on its left. A traction (12 x, -25 x) on its top
bends it onto a rigid foundation, on which it slides with Coulomb friction:

    -div sigma(u) = 0,    u = 0 on x = 0,    sigma n = (12 x, -25 x) on y = 1,
    0 <= p _|_ u_y + g >= 0,    |tau| <= F p,    tau opposes the slip, on y = 0.

Young's modulus 20000 E, F and the gap g are not known. 15 gauges on the top measure both components of the
displacement. Here they are computed with E = 1.2, F = 0.35, g = 0.01 on a mesh four times as fine, and normal
noise of 1 % of the largest displacement is added. The design variables are E, F and g:

    minimise   mean over the 30 measured values of (u(x_k) - m_k)^2 / s^2,    s the deviation of the noise.

About 0.9 is to be expected at the best fit, as 3 of the 30 degrees of freedom are fitted. With Coulomb
friction there is no energy that both levels could share.

    python scripts/gallery/identification.py --n 4 --picture identification.png
    rmesh compare scripts/gallery/identification.toml \
        --formulations nested,mpcc --out identification
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from common import command_line, save
from designs import FINER, SEEDS, Starts, along, five_starts, on_finer_meshes, surviving
from numpy.typing import NDArray

import rmesh_nlp as rm
from rmesh_nlp.fem.objective import Objective
from rmesh_nlp.fem.space import DisplacementSpace

TRUTH = {"E": 1.2, "F": 0.35, "g": 0.01}
GAUGES = np.stack([np.linspace(0.5, 4.0, 15), np.ones(15)])
"""(2, 15) places on the top."""

NOISE, SEED = 0.01, 7
"""Deviation of the noise over the largest displacement, and the seed it is drawn with."""

OTHER = (0.0, 0.005, 0.02, 0.05)
"""Other levels of noise, of the same draw."""

STEP = 1e-4
"""Relative step of differences by which standard errors are computed."""


@dataclass(frozen=True)
class Measured:
    """Displacements (2, gauges) with noise, without, and the deviation of the noise."""

    values: NDArray[np.float64]
    exact: NDArray[np.float64]
    deviation: float

    @property
    def objective(self) -> Objective:
        """Mean square of the misfits in units of the noise."""
        weight = 1 / (self.values.size * self.deviation**2)
        return rm.quantities.fit(GAUGES, self.values, np.full(GAUGES.shape[1], weight))


@dataclass(frozen=True)
class Identified:
    """The solves, start and best fit on meshes 1, 2 and 4 times as fine, and the data."""

    starts: Starts
    finer: list[tuple[rm.Solution, rm.Solution]]
    data: Measured


def problem(n: int, order: int = 2) -> rm.ContactProblem:
    """The slab on ``4 n`` x ``n`` squares."""
    young = rm.DesignVariable("E", 1.0, (0.5, 2.0))
    friction = rm.DesignVariable("F", 0.2, (0.0, 1.0))
    gap = rm.DesignVariable("g", 0.005, (0.0, 0.02))
    return rm.ContactProblem(
        mesh=rm.shapes.rectangle(4 * n, n, x=(0, 4)),
        law=rm.PlaneStrain.from_young(20000 * young.symbol, 0.3),
        dirichlet=("left",),
        obstacle=rm.Obstacle("bottom", offset=gap.symbol, coulomb=friction.symbol),
        motion=rm.Motion(0.0),
        tractions=(rm.Traction("top", (lambda x, y: 12 * x, lambda x, y: -25 * x)),),
        design=(young, friction, gap),
        order=order,
        name="identification",
    )


def at_gauges(slab: rm.ContactProblem, design: Mapping[str, float]) -> NDArray[np.float64]:
    """(2, gauges) displacements; the gauges must be at nodes."""
    solution = rm.solve(slab.at_design(design), "fixed")
    points = DisplacementSpace(solution.problem).points(np.asarray(solution.mesh.p))
    distance = np.linalg.norm(points[:, :, None] - GAUGES[:, None], axis=0)
    assert np.max(distance.min(axis=0)) < 1e-9, "no node at a gauge"
    return solution.displacement[:, distance.argmin(axis=0)]


def measured(exact: NDArray[np.float64], noise: float = NOISE, seed: int = SEED) -> Measured:
    """Displacements (2, gauges) with noise; without any the misfit is in units of ``NOISE``."""
    largest = float(np.max(np.abs(exact)))
    drawn = np.random.default_rng(seed).standard_normal(exact.shape)
    return Measured(exact + noise * largest * drawn, exact, (noise or NOISE) * largest)


def write(data: Measured, path: Path) -> None:
    """The data as a file for ``fit(FILE)``, the weights in units of the noise."""
    weight = 1 / (data.values.size * data.deviation**2)
    rows = [
        f"{x:g},{y:g},{ux:.8e},{uy:.8e},{weight:.8e}" for x, y, ux, uy in np.vstack([GAUGES, data.values]).T
    ]
    path.write_text("\n".join(["x,y,ux,uy,weight", *rows]) + "\n")


def standard_errors(
    slab: rm.ContactProblem, design: Mapping[str, float], deviation: float
) -> dict[str, float]:
    """Of E, F and g, by the linearised model: the roots of the diagonal of s^2 (J^T J)^-1."""
    columns = []
    for name, value in design.items():
        ends = [at_gauges(slab, {**design, name: value * (1 + sign * STEP)}) for sign in (1, -1)]
        columns.append((ends[0] - ends[1]).ravel() / (2 * STEP * value))
    jacobian = np.stack(columns, axis=1)
    covariance = deviation**2 * np.linalg.inv(jacobian.T @ jacobian)
    return dict(zip(design, np.sqrt(np.diag(covariance)).tolist(), strict=True))


def main(n: int = 4, order: int = 2, seeds: Sequence[int | None] = SEEDS) -> Identified:
    """Identify E, F and g from each start, and measure the misfit again on finer meshes."""
    slab, exact = problem(n, order), at_gauges(problem(4 * n, order), TRUTH)
    data = measured(exact)
    starts = five_starts(slab, data.objective, seeds)
    best = starts.best.design
    finer = on_finer_meshes([problem(factor * n, order) for factor in FINER], data.objective, best)
    print(starts.table)
    for (formulation, seed), end in starts.solutions.items():
        print(formulation, seed, ", ".join(f"{name} = {value:.4f}" for name, value in end.design.items()))
    errors = standard_errors(slab, best, data.deviation)
    for name, value in best.items():
        off = value / TRUTH[name] - 1
        print(f"{name}: {value:.5g}, truth {TRUTH[name]:g} ({off:+.1%}), standard error {errors[name]:.2g}")
    for noise in OTHER:
        fit = rm.solve(slab, "mpcc", objective=measured(exact, noise).objective)
        off = ", ".join(f"{name} {value / TRUTH[name] - 1:+.1%}" for name, value in fit.design.items())
        print(f"noise {noise:.1%}: {fit.status.value}, objective {fit.assessment.final.objective:.3g}, {off}")
    for factor, (first, last) in zip(FINER, finer, strict=True):
        print(
            f"h/{factor}: misfit {first.assessment.final.objective:.5g} -> "
            f"{last.assessment.final.objective:.5g}"
        )
    print(f"gain_surviving {starts.best.record()['gain_surviving']:.4f}, on h/4 {surviving(finer):.4f}")
    return Identified(starts, finer, data)


def draw(fit: Identified, path: Path) -> None:
    """Measured and fitted displacements of the top, and pressure and friction where the slab slides."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    first, last = fit.finer[0]
    x = GAUGES[0]
    for axis, row, component in zip(axes, (0, 1), ("x", "y"), strict=False):
        axis.errorbar(
            x,
            1e3 * fit.data.values[row],
            1e3 * fit.data.deviation,
            fmt="o",
            color="0.3",
            markersize=3,
            linewidth=0.8,
            label="measured, with its deviation",
        )
        for end, color, style, name in (
            (first, "#D55E00", "--", "start"),
            (last, "#0072B2", "-", "best fit"),
        ):
            nodes = along(end, "top")
            axis.plot(
                end.mesh.p[0, nodes], 1e3 * end.displacement[row, nodes], style, color=color, label=name
            )
        axis.set(xlabel="x", ylabel=f"displacement in {component} [1e-3]", title=f"top, along {component}")
        axis.legend(frameon=False)
    nodes = along(last, "bottom")
    at, friction = last.mesh.p[0, nodes], fit.starts.best.design["F"]
    axes[2].plot(at, last.pressure[nodes], color="#0072B2", label="pressure p")
    axes[2].plot(at, friction * last.pressure[nodes], "--", color="0.5", label="bound F p")
    axes[2].plot(
        at, np.abs(last.tangential_stress[nodes]), "o", color="#009E73", markersize=3, label="friction"
    )
    axes[2].set(xlabel="x", ylabel="stress", title="foundation at the best fit", ylim=(0, None))
    axes[2].legend(frameon=False)
    save(figure, path)


if __name__ == "__main__":
    command_line(main, 4, draw)
