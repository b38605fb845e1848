"""Is relocation worth it: error before and after, and what other meshes would need for the same.

The error of the energy is half the squared error in the energy norm, plus what contact and friction
contribute (4.1); it falls like one over the number of nodes where the solution is smooth.

Without an exact energy the error after is extrapolated from refinements of the relocated mesh, and that
before is larger by the fall of the energy. Extrapolation from the mesh as given understates its error where
the solution is singular, by a quarter at a re-entrant corner, and what is left after a good relocation by
much more; on the relocated mesh, whose elements have more equal errors, it hardly does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from skfem import MeshTri

from rmesh_nlp.contact.model import ContactModel
from rmesh_nlp.display import figure
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.edge_gaps import with_edge_gaps
from rmesh_nlp.problem import ContactProblem
from rmesh_nlp.programs.cascade import cascade
from rmesh_nlp.programs.cascade_settings import CascadeSettings
from rmesh_nlp.programs.hr import EFFECTIVITY
from rmesh_nlp.programs.levels import refined
from rmesh_nlp.programs.refinement import edge_gains
from rmesh_nlp.solution.certify import Certificate

REFINED_NODES = 20000
"""Largest mesh whose error is extrapolated from a uniform refinement; that of a larger one is estimated
from the gains of new nodes on its edges."""

REFINED_TWICE = 1500
"""Largest number of nodes of a mesh that is refined twice for an extrapolation."""

WORTHWHILE = 1.5
"""Factor by which an error must fall for a method to be recommended."""


@dataclass(frozen=True)
class Worth:
    """What a relocation is worth.

    Attributes
    ----------
    error_initial, error : float
        Error of the energy before and after.
    source : str
        What the errors are measured against: "exact", "extrapolated" or "estimated"; or "certified", where
        errors are upper bounds and the factor is a lower one, and "bracket", where the certificate's bounds
        are not guaranteed.
    factor : float
    nodes : int
    uniform_nodes, adaptive_nodes : int
        Nodes of a uniformly and of an ideally locally refined mesh with the error after.
    contact_solves : int
    gain_geometry : float, optional
        Where nodes slide along curves: part of the decrease of the energy that is due to another polygon, and
        not to a better solution on it. Errors and factor are without it.
    """

    error_initial: float
    error: float
    source: str
    factor: float
    nodes: int
    uniform_nodes: int
    adaptive_nodes: int
    contact_solves: int
    gain_geometry: float | None = None

    def text(self) -> str:
        """In plain words."""
        by = {
            "exact": "by the exact energy",
            "extrapolated": "extrapolated from a uniform refinement",
            "estimated": "estimated from the gains of new nodes",
            "certified": "proved by the certificate",
            "bracket": "by the certificate, whose bounds are not guaranteed here",
        }[self.source]
        at_most, at_least = ("at most ", "at least ") if self.source == "certified" else ("", "")
        before, after = figure(self.error_initial), figure(self.error)
        errors = f"error of the energy {at_most}{before} before, {at_most}{after} after ({by})"
        cost = f"for {self.contact_solves} contact solves"
        gain = f"{at_least}{self.factor:.2g} times less on {self.nodes} nodes, {cost}"
        others = f"a uniform grid needs about {self.uniform_nodes} nodes for that"
        text = f"{errors}: {gain}; {others}, an ideally refined one {self.adaptive_nodes}"
        if self.gain_geometry is not None:
            text += f"; another {figure(self.gain_geometry)} of energy came from the shape of the polygon"
        return text

    def record(self) -> dict[str, Any]:
        """As plain values, with the text."""
        return {**asdict(self), "text": self.text()}


def worth(
    problem: ContactProblem, mesh: MeshTri, initial: float, final: float, contact_solves: int
) -> Worth | None:
    """What lowering the audited energy from ``initial`` to ``final`` is worth; None if nothing can be said.

    Parameters
    ----------
    problem : ContactProblem
        On the mesh as given.
    mesh : MeshTri
        The relocated one.
    """
    local = edge_gains(problem)
    geometry = gain_of_polygon(problem, mesh) if problem.motion.curves else None
    fall = initial - final - (geometry or 0.0)
    after, source = error_of(replace(problem, mesh=mesh), final)
    before = after + fall
    if not before > 0 or not after > 0.01 * before:
        return None  # the estimate of the error is as small as its own error
    nodes, factor = int(problem.mesh.p.shape[1]), before / after
    same = _uniform(problem, before, after), _ideal(nodes, local, factor)
    return Worth(before, after, source, factor, nodes, *same, contact_solves, geometry)


def by_certificate(found: Mapping[str, Any], certificate: Certificate) -> dict[str, Any]:
    """The record of a :class:`Worth` with the bounds of a certificate in the place of what was extrapolated.

    ``E - lower`` bounds the error of an energy E from above. The true factor ``(E_0 - J) / (E_1 - J)``, with
    J the least energy, grows with J, so that ``(E_0 - lower) / (E_1 - lower)`` bounds it from below. What is
    measured against an exact energy stays; so does what counts the polygon of a curved boundary.
    """
    values = {name: value for name, value in found.items() if name != "text"}
    one = Worth(**values)
    before, after = (bound**2 / 2 for bound in (certificate.error_bound_initial, certificate.error_bound))
    if one.source == "exact" or one.gain_geometry is not None or not before >= after > 0:
        return one.record()
    proved = certificate.guaranteed_lower and certificate.guaranteed_upper and certificate.guaranteed_initial
    factor = before / after
    return replace(
        one,
        error_initial=before,
        error=after,
        source="certified" if proved else "bracket",
        factor=factor,
        uniform_nodes=round(one.nodes * factor),
        adaptive_nodes=round(one.adaptive_nodes * factor / one.factor),
    ).record()


def gain_of_polygon(problem: ContactProblem, mesh: MeshTri) -> float:
    """Decrease of the exact energy by another polygon in the place of a curved boundary.

    Where nodes slide along a curve the polygon through them changes, its area by O(h^2), and with it the
    exact energy of the discrete domain: as much as the error of the energy. Both exact energies are
    extrapolated from refinements that keep the polygon.
    """
    return _limit(problem) - _limit(replace(problem, mesh=mesh))


def _limit(problem: ContactProblem) -> float:
    """The energy on the domain of the mesh, a polygon, extrapolated from two uniform refinements or one."""
    fine = _accurate(problem)
    energies = []
    for _ in range(2 if problem.mesh.p.shape[1] <= REFINED_TWICE else 1):
        fine = refined(fine, polygon=True)
        energies.append(ContactModel(fine).solve(fine.mesh.p).energy)
    if len(energies) == 1:
        energies.insert(0, ContactModel(_accurate(problem)).solve(problem.mesh.p).energy)
    return energies[1] + (energies[1] - energies[0]) / 3


def error_of(relocated: ContactProblem, energy: float) -> tuple[float, str]:
    """Error of the ``energy`` of a relocated mesh, and where it is from."""
    if relocated.exact is not None and not relocated.motion.curves:
        return energy - relocated.exact.energy, "exact"
    if relocated.mesh.p.shape[1] > REFINED_NODES:
        return float(edge_gains(relocated).sum()) / EFFECTIVITY, "estimated"
    _, energies = _refinements(relocated)
    first, ratio = energies[0] - energies[1], 4.0
    if len(energies) == 3 and first > energies[1] - energies[2] > 0:
        # a geometric series, slower than that of smooth solutions where this one is not
        ratio = float(np.clip(first / (energies[1] - energies[2]), 2.0, 4.0))
    return first / (1 - 1 / ratio), "extrapolated"


def _refinements(problem: ContactProblem) -> tuple[list[int], list[float]]:
    """Nodes and energies of a mesh and of two uniform refinements, of one if it is large."""
    here = _accurate(problem)
    nodes, energies = [], []
    for _ in range(3 if problem.mesh.p.shape[1] <= REFINED_TWICE else 2):
        nodes.append(int(here.mesh.p.shape[1]))
        energies.append(ContactModel(here).solve(here.mesh.p).energy)
        here = refined(here, polygon=True)
    return nodes, energies


def _uniform(problem: ContactProblem, before: float, after: float) -> int:
    """Nodes of a uniform refinement with the error ``after``, by the rate of two refinements."""
    n = int(problem.mesh.p.shape[1])
    if n > REFINED_TWICE:  # one refinement alone does not tell the rate of still finer meshes
        return round(n * before / after)
    nodes, energies = _refinements(problem)
    errors = before - (energies[0] - np.asarray(energies))
    if not (np.all(np.diff(errors) < 0) and errors[-1] > 0.01 * before):
        return round(n * before / after)
    k = 1 if after > errors[1] else 2
    slope = np.log(nodes[k] / nodes[k - 1]) / np.log(errors[k] / errors[k - 1])
    return round(float(nodes[k] * (after / errors[k]) ** slope))


def _accurate(problem: ContactProblem) -> ContactProblem:
    rule = problem.rule
    return replace(problem, quadrature=max(rule, 6) if isinstance(rule, int) else 6)


def _ideal(nodes: int, local: Array, factor: float) -> int:
    """Nodes of the locally refined mesh with a ``factor`` times smaller error.

    With an error that is c h^2 times the area, the best sizes make all elements' errors equal, and M
    elements with errors e_T are then worth ``(sum sqrt(e_T))^2 / sum e_T`` ones.
    """
    share = np.sum(np.sqrt(local)) ** 2 / (local.size * np.sum(local)) if np.any(local > 0) else 1.0
    return max(1, round(nodes * factor * float(share)))


@dataclass(frozen=True)
class Advice:
    """What ``rmesh advise`` finds.

    Attributes
    ----------
    relocation : float
        Factor by which the error falls on this mesh by a map found on a coarse one, with one iteration on
        this one.
    refinement : float
        Factor by which as many nodes, ideally distributed by local refinement, would lower it.
    rate : float
        The error falls like (number of nodes)^-rate under uniform refinement; 1 if the solution is smooth.
    error : float
        Of the energy, extrapolated with this rate.
    recommendation : str
    """

    relocation: float
    refinement: float
    rate: float
    error: float
    recommendation: str

    def rows(self) -> list[tuple[str, str]]:
        """As (label, value) for people."""
        moved = f"{self.relocation:.2g} times less error"
        return [
            ("error of the energy, extrapolated", figure(self.error)),
            ("rate under uniform refinement", f"N^-{self.rate:.2f}"),
            ("relocation, coarse map only", moved),
            ("local refinement, same nodes", f"{self.refinement:.2g} times less error"),
            ("recommendation", self.recommendation),
        ]


def advise(problem: ContactProblem, settings: CascadeSettings | Mapping[str, Any] | None = None) -> Advice:
    """Relocate on the coarsest mesh, prolong the map, refine uniformly twice; recommend what to do.

    Costs about the contact solves of two uniform refinements. Boxes are not regarded; over curved
    foundations gaps hold along edges, as in ``auto``.
    """
    chosen = CascadeSettings.of(settings)
    problem = with_edge_gaps(problem)
    free = replace(problem, motion=replace(problem.motion, delta=None))
    given = _accurate(free)
    finer = refined(given, polygon=True)
    grids = [given, finer, refined(finer)]
    models = [ContactModel(grid) for grid in grids]
    energies = [model.solve(model.problem.mesh.p).energy for model in models]
    first, second = energies[0] - energies[1], energies[1] - energies[2]
    rate = float(np.clip(np.log2(first / second) / 2, 0.2, 1.5)) if first > 0 and second > 0 else 1.0
    error = max(first / (1 - 4**-rate), 1e-300)
    last = cascade(given, replace(chosen, brief=1, brief_unnested=1)).levels[-1]
    left = error - (energies[0] - last.energy)
    relocation = error / max(left, 0.01 * error)
    local = edge_gains(given)
    refinement = local.size * float(np.sum(local)) / max(float(np.sum(np.sqrt(local))) ** 2, 1e-300)
    return Advice(relocation, refinement, rate, error, recommended(relocation, refinement, rate))


def recommended(relocation: float, refinement: float, rate: float) -> str:
    """What to do, from the figures of :class:`Advice`."""
    move, refine = relocation >= WORTHWHILE, refinement >= WORTHWHILE or rate < 0.85
    if move and refine:
        return "both: relocate (rmesh solve), then refine where the error is (rmesh_nlp.programs.hr)"
    if move:
        return "relocate: rmesh solve"
    if refine:
        return "refine locally: relocation alone gains little here"
    return "refine uniformly: the mesh suits the solution already"
