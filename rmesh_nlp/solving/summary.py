"""A solution as rows for people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.table import Column, Table

from rmesh_nlp.display import Rows, bounds_in_words, figure, within_in_words
from rmesh_nlp.evaluation import ROUNDING, difference
from rmesh_nlp.optimize.activity import ZERO
from rmesh_nlp.optimize.status import success_in_words
from rmesh_nlp.problem.units import NO_UNITS, bracketed
from rmesh_nlp.settings import ByName
from rmesh_nlp.solving.relocated import Relocated


def summary(solution: Relocated) -> Rows:
    """Status, energies and measured residuals of a Solution, as (label, value) rows for people."""
    final, trace, conditions = solution.final, solution.trace, solution.assessment.first_order
    motion = np.linalg.norm(final.mesh.p - final.before, axis=0)
    rows = [
        ("status", f"{solution.status.value}: {solution.message}"),
        ("success", success_in_words(solution.success, solution.status)),
        *([] if solution.chosen is None else [("chosen", solution.chosen)]),
        *_objective_rows(solution),
        *_energy_rows(solution),
        *contact_rows(solution),
        ("first-order residual", "-" if np.isnan(conditions.residual) else f"{conditions.residual:.1e}"),
        ("least area ratio", figure(final.min_area_ratio)),
        ("largest motion", figure(float(motion.max()))),
        ("equilibrium residual", f"{final.residuals.equilibrium:.1e}"),
        ("complementarity residual", f"{final.residuals.complementarity:.1e}"),
        ("penetration between nodes", figure(final.penetration)),
        ("iterations, contact solves", f"{trace.iterations}, {trace.work.contact_solves}"),
        ("seconds", f"{trace.wall_time_s:.3g}"),
    ]
    if final.coulomb_residual is not None:
        before, after = solution.given.coulomb_residual, final.coulomb_residual
        rows.append(("Coulomb's law along edges", f"residual {before:.1e}, {after:.1e}"))
    if not solution.assessment.is_same_mesh:
        rows.insert(2, ("mesh", f"{solution.mesh.p.shape[1]} nodes, made for the solution"))
    if solution.error_reduction is not None:
        rows.append(("error reduction", solution.error_reduction.text()))
    if (attained := solution.reduced_error.attained) is not None:
        said = f"{attained.attainable_factor:.2g} times less error: {attained.share_of_attainable:.0%} of "
        said += "that is reached"
        rows.append(("best mesh of as many triangles", said))
    if solution.multipliers is not None and not solution.problem.motion.is_fixed:
        pulls = solution.multipliers
        for by, what, rate in (("move limits", "nodes", pulls.limit), ("areas", "elements", pulls.area)):
            rows.append((f"limited by {by}", f"{np.sum(rate > 0)} {what}, largest {figure(rate.max())}"))
    return rows


def _objective_rows(solution: Relocated) -> list[tuple[str, str]]:
    """Another objective than the energy, the design, and what is constrained."""
    rows: list[tuple[str, str]] = []
    assessment, surviving = solution.assessment, solution.surviving_gain
    if assessment.final.point is not None and not solution.objective.startswith("energy"):
        rows.append(("objective", solution.objective))
        first = assessment.given.objective if assessment.is_same_mesh else None
        last = assessment.final.objective
        if first is not None:
            rows.append(("objective at the start", figure(first)))
        rows.append(("objective at the end", figure(last)))
        if first is not None:
            rows.append(("gain", gain_in_words(first, last)))
    if surviving is not None:
        rows.append(("gain left on refined meshes", f"{surviving.share:.0%} of the objective's"))
    for variable in () if solution.assessment.designed is None else solution.assessment.designed.design:
        if variable.name not in solution.design:
            continue
        value, (low, high) = solution.design[variable.name], variable.bounds
        at_bound = min(value - low, high - value) <= ZERO * (high - low)
        said = figure(value) + (", at its bound," if at_bound else "")
        said += f" from {figure(variable.start)}, bounds {bounds_in_words(low, high)}"
        rows.append((f"design variable {variable.name}", said))
    constrained = solution.constraints.items()
    return rows + [(f"constraint {text}", quantity.in_words()) for text, quantity in constrained]


def _energy_rows(solution: Relocated) -> list[tuple[str, str]]:
    """The energies; none where they do not compare: of several designs, or with Coulomb friction."""
    of_another = not solution.problem.has_energy and not solution.objective.startswith("energy")
    if solution.assessment.designed is not None or of_another:
        return []
    by_rule = f"{figure(solution.energy_initial)}, {figure(solution.energy)}"
    own = [("energies by the rule of the problem", by_rule)]
    if not solution.assessment.is_audited:
        return own
    return [
        ("audited energy on the given mesh", figure(solution.energy_initial_audited)),
        ("audited energy", figure(solution.energy_audited)),
        ("audited gain", gain_in_words(solution.energy_initial_audited, solution.energy_audited)),
        *own,
    ]


QUANTITIES = {"normal_force": "resultant", "peak_pressure": "peak"}
"""Quantities that are results of contact by another name."""


def estimate_in_words(of: ByName) -> str:
    """An entry of ``estimates`` in words."""
    if not of["converges"]:
        return f"does not converge, or may have no limit: {figure(of['value'])} on the last mesh"
    said = f"{of['value']:.6g} +- {of['error']:.2g} estimated".replace(" +- nan", ", no error")
    computed = figure(of["computed"])
    said += f" (computed {computed})" if computed != figure(of["value"]) else ""
    if of.get("guaranteed"):
        said += f", guaranteed {bounds_in_words(of['lower'], of['upper'])}{within_in_words(of['within'])}"
    return said


def mesh_table(meshes: Sequence[ByName]) -> Table:
    """Quantities with their estimated errors, a row for each mesh."""
    table = Table("nodes", "seconds", *(Column(text, overflow="fold") for text in meshes[0]["quantities"]))
    for mesh in meshes:
        said = (
            f"{of['value']:.6g} +- {of['error']:.2g}".replace(" +- nan", "")
            for of in mesh["quantities"].values()
        )
        table.add_row(f"{mesh['nodes']}", f"{mesh['seconds']:.2g}", *said)
    return table


def step_table(steps: Sequence[ByName]) -> Table:
    """What each contact boundary carries after each load step."""
    names = [(boundary, f"{kind}_force") for boundary in steps[0] for kind in ("normal", "tangential")]
    table = Table("step", *(f"{boundary}: {name.replace('_', ' ')}" for boundary, name in names))
    for number, results in enumerate(steps, 1):
        table.add_row(f"{number}", *(figure(results[boundary][name]) for boundary, name in names))
    return table


def contact_rows(solution: Relocated) -> Rows:
    """What each contact boundary carries, on the given mesh, the relocated one and its refinement."""
    rows, units = [], solution.problem.units if solution.problem.components == 2 else NO_UNITS
    named = {"peak_pressure": units.stress, "contact_length": units.length}
    estimates = dict(solution.details.get("estimates", {}))
    meshes = {"_initial": "given", "": "relocated", "_refined": "refined"}
    for boundary, results in solution.contact.items():
        place = " and ".join(solution.pairs.get(boundary, [boundary]))
        for name in ("normal_force", "tangential_force", "peak_pressure", "contact_length"):
            if f"{name}_initial" not in results:
                continue
            values = {mesh: results[name + end] for end, mesh in meshes.items() if name + end in results}
            if name != "tangential_force" or any(values.values()):
                figures = {mesh: figure(value) for mesh, value in values.items()}
                differ = len(set(figures.values())) > 1 and "meshes" not in solution.details
                each = ", ".join(f"{value} {mesh}" for mesh, value in figures.items())
                said = each if differ else figures["relocated"]
                if (of := estimates.pop(f"{QUANTITIES.get(name, name)}({boundary})", None)) is not None:
                    said = estimate_in_words(of) + f"; {each}" * differ
                unit = bracketed(named.get(name, units.line_force))
                extent = "area" if boundary == "interior" else "length"
                rows.append((f"{place}: {name.replace('_', ' ').replace('length', extent)}{unit}", said))
        if "force_x" in results:
            least = ROUNDING * results["normal_force"]
            vector = (results[name] for name in ("force_x", "force_y", "moment"))
            x, y, moment = (figure(value if abs(value) > least else 0.0) for value in vector)
            body = f"force on the {'first ' * (place != boundary)}body{bracketed(units.line_force)}"
            said = y if units.per else f"({x}, {y}), moment {moment}"
            rows.append((f"{place}: {'axial ' * bool(units.per)}{body}", said))
        if boundary in solution.tools:
            moved = ", ".join(map(figure, solution.tools[boundary]["displacement"]))
            rows.append((f"{boundary}: displacement of the tool{bracketed(units.length)}", f"({moved})"))
    return rows + [(text, estimate_in_words(of)) for text, of in estimates.items()]


def gain_in_words(before: float, after: float) -> str:
    """A gain by itself and as a part of the initial value."""
    gain = difference(before, after)
    return figure(gain) + (f" ({100 * gain / abs(before):.3g} %)" if before else "")
