"""Short description of a problem, as (label, value) rows."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.display import Rows, describe, figure
from rmesh_nlp.problem.laws import Laplace, Law
from rmesh_nlp.problem.motion import Motion, Relative
from rmesh_nlp.problem.obstacle import Place
from rmesh_nlp.problem.statement import ContactSet, Statement
from rmesh_nlp.problem.units import after

BY_BARRIER = "by auto, and with a regularisation: only positive"
"""What becomes of the least area where a distortion is minimised with the energy: it is a barrier."""


def summary_of_problem(problem: Statement) -> Rows:
    """Mesh, laws, loads, contact and motion of a problem."""
    mesh = problem.mesh
    (x0, y0), (x1, y1) = mesh.p.min(axis=1), mesh.p.max(axis=1)
    boundaries = [
        f"{n} ({np.size(f)})" for n, f in (mesh.boundaries or {}).items() if not n.startswith("gmsh:")
    ]
    rows = [
        ("mesh", f"{mesh.p.shape[1]} nodes, {mesh.t.shape[1]} triangles"),
        ("extent", f"({figure(x0)}, {figure(x1)}) x ({figure(y0)}, {figure(y1)})"),
        ("boundaries (edges)", ", ".join(boundaries)),
    ]
    for law, elements in problem.regions:
        rows.append((f"law of {elements.size} triangles", _law(law, after(problem.units.stress))))
    for support in problem.supports:
        rows.append((f"given on {support.boundary}", ", ".join(describe(v) for v in support.value)))
    for traction in problem.tractions:
        rows.append((f"traction on {traction.boundary}", ", ".join(describe(v) for v in traction.value)))
    for load in problem.point_loads:
        rows.append((f"force at node {load.node}", ", ".join(figure(v) for v in load.force)))
    rows += [("contact", _contact(problem)), ("motion", _motion(problem.motion))]
    return rows


def _law(law: Law, stress: str) -> str:
    if isinstance(law, Laplace):
        return f"Laplace, conductivity {figure(law.conductivity)}, source {describe(law.source)}"
    force = ", ".join(describe(component) for component in law.body_force)
    lame = f"lambda {figure(law.lame_lambda)}, mu {figure(law.lame_mu)}{stress}"
    return f"{type(law).__name__}, {lame}, body force ({force})"


def _contact(problem: Statement) -> str:
    return "; ".join(_one_contact(part) for part in problem.contact_sets) or "none"


def _one_contact(part: ContactSet) -> str:
    obstacle = part.obstacle
    where = "in the interior" if obstacle.boundary is Place.INTERIOR else f"on {obstacle.boundary}"
    if obstacle.level is not None:
        normal = "the normal of the curve at each undeformed node"
    else:
        normal = f"normal ({', '.join(figure(v) for v in obstacle.normal)})"
    friction = f", friction bound {describe(obstacle.friction)}" if obstacle.frictional else ", no friction"
    return f"{part.nodes.size} nodes {where}, {normal}{friction}"


def _motion(motion: Motion) -> str:
    if isinstance(motion.delta, Relative):
        text = f"delta {figure(motion.delta.fraction)} of the shortest edge"
    elif motion.delta is None:
        text = "no move limits"
    else:
        text = "delta " + " x ".join(figure(v) for v in motion.delta)  # type: ignore[union-attr]
    text += f", areas at least {figure(motion.min_area_fraction)} of the given ones"
    if motion.min_angle > 0:
        text += f", angles at least {figure(motion.min_angle)} degrees"
    elif motion.delta is None:
        text += f" ({BY_BARRIER})"
    for rule in ("pinned", "slides", "free"):
        places = getattr(motion, rule)
        if places:
            text += f"; {rule}: {', '.join(str(place) for place in places)}"
    if motion.curves:
        text += f"; along curves: {', '.join(motion.curves)}"
    return text + (f"; {len(motion.tied)} nodes tied" if motion.tied else "")
