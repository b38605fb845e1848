"""The entries of a record, one declaration of each.

:mod:`rmesh_nlp.io.records` checks what it reads by their types, tables take headings and digits, and
docs/records.md is made of the meanings. What a formulation adds of its own are the ``details`` of its
outcome; their declarations have no value of a Solution.
"""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable
from dataclasses import asdict
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np

from rmesh_nlp.contact.factorisation import HAS_CHOLMOD
from rmesh_nlp.fem.space import DisplacementSpace
from rmesh_nlp.meshes.mmg import is_available
from rmesh_nlp.settings import Values
from rmesh_nlp.solving.entry import (
    EVERY,
    KNOWN,
    SOLVED,
    Count,
    Entry,
    Named,
    Number,
    Seconds,
    Text,
    Widths,
    attribute,
    of_energies,
    of_seconds,
)
from rmesh_nlp.solving.relocated import Relocated


def _seconds(name: str, meaning: str, of: str | None, **options: Any) -> Entry:
    return Entry(name, Seconds, meaning, of, **{"presence": SOLVED, "unit": "s", **options})


def _own_design(solution: Relocated, of: Callable[[Any], object]) -> dict[str, object] | None:
    """Of each design variable that the solve had."""
    if solution.assessment.designed is None:
        return None
    return {one.name: of(one) for one in solution.assessment.designed.design if one.name in solution.design}


def _objective_initial(solution: Relocated) -> float | None:
    is_known = solution.final.point is not None and solution.assessment.is_same_mesh
    return solution.given.objective if is_known else None


def _remark(solution: Relocated) -> str | None:
    return solution.certificate_remark if solution.certificate is None else solution.certificate.why


def _bounds(solution: Relocated) -> dict[str, dict[str, object]] | None:
    if (certificate := solution.certificate) is None:
        return None
    return {name: of._asdict() for name, of in certificate.bounds.items()} or None


@cache
def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide the figures."""
    packages: tuple[str, ...] = ("rmesh-nlp", "casadi", "numpy", "scipy", "scikit-fem")
    if HAS_CHOLMOD:  # factors by CHOLMOD differ by rounding
        packages = (*packages, "scikit-sparse")
    if is_available():
        packages = (*packages, "mmgpy")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}


# fmt: off
def _contact(suffix: str, where: str, path: str) -> tuple[Entry, ...]:
    """Results of the contact on one of the meshes."""

    def on(name: str, total: Callable[[Iterable[float]], float] = sum) -> Callable[[Relocated], float | None]:
        def value(solution: Relocated) -> float | None:
            results = attribute(solution, path).values()
            return total(getattr(result, name) for result in results) if results else None

        return value

    return (
        Entry(f"peak_pressure{suffix}", Number, f"Largest contact pressure on {where}.",
              on("peak_pressure", max), unit="force/length^2",
              digits=".4g"),
        Entry(f"resultant{suffix}", Number,
              f"Sum of the normal forces of all contact boundaries on {where}, the integrals of their "
              "pressures, whatever their directions; `contact` has each. Of a body of revolution a force.",
              on("normal_force"), unit="force/length", heading="normal|force", digits=".4g"),
        Entry(f"contact_length{suffix}", Number,
              f"Length of all contact boundaries where they press on {where}; of an interior obstacle an "
              "area.",
              on("contact_length"), unit="length"),
    )


SECTIONS: dict[str, tuple[Entry, ...]] = {
    "What was solved": (
        Entry("key", str, "Name of the solve, and of its files in `solutions/`."),
        Entry("example", str, "Name of the problem.", "problem.name", EVERY),
        Entry("formulation", str, "That solved it.", "formulation", EVERY),
        Entry("objective", str, "What was minimised.", "objective", EVERY),
        Entry("n", str, "Size of the mesh, as the problem gives it.", "problem.size", EVERY),
        Entry("delta", Widths, "Move limits along x and y, a part of the shortest edge, or null for none.",
              lambda s: s.problem.motion.delta_record(), EVERY, unit="length"),
        Entry("order", Count, "Of the displacements on each triangle: 1 linear, 2 quadratic.",
              "problem.order", SOLVED),
        Entry("nodes", Count, "Vertices of the mesh.", lambda s: s.mesh.p.shape[1], SOLVED),
        Entry("triangles", Count, "Of the mesh.", lambda s: s.mesh.nelements, SOLVED),
        Entry("unknowns", Count, "Of the displacement.",
              lambda s: int(np.sum(~DisplacementSpace(s.problem).given()[0])), SOLVED),
        Entry("quadrature", str | int, "Rule for the loads: `midpoint` or a degree.",
              "problem.rule", SOLVED),
        Entry("units", dict[str, str] | None, "Of the problem, if it names any; `per` is `revolution` where "
              "energies and forces are of a whole body of revolution.",
              lambda s: {k: v for k, v in asdict(s.problem.units).items() if v or k != "per"}, SOLVED),
        Entry("start", Text, "Where the solve started: `given`, `random`, `positions`, or the formulation "
              "whose solution it was.", "start", SOLVED),
        Entry("seed", Count, "Of random numbers; null for the start from the given mesh.", "seed",
              EVERY),
        Entry("settings", Values, "That differ from the defaults.", lambda s: dict(s.settings),
              SOLVED),
        Entry("limits", Values, "Of time and iterations.", lambda s: s.limits.changed() or None),
        Entry("tolerance", Number, "Of the first-order residual.", "assessment.tolerance", SOLVED),
        Entry("chosen_by", Text, "`auto`, where it chose the formulation.", "chosen_by"),
        Entry("chosen", Text, "Why it chose that.", "chosen"),
        Entry("safe", Text, "What followed an exploited end, see [the assessment](assessment.md).",
              "safe"),
        Entry("versions", Any, "Of Python and of the packages that decide the figures.", lambda _: versions(),
              EVERY),
    ),
    "How it ended": (
        Entry("status", str, "That of the assessment; `refused` and `failed` are solves that raised.",
              "status.value", EVERY),
        Entry("success", bool, "Valid and improved.", "success", EVERY),
        Entry("valid", bool, "Whether the contact problem is solved on the final mesh, see [the "
              "assessment](assessment.md).", "valid", SOLVED),
        Entry("improved", bool, "Whether the minimised objective is not above its value on the given mesh.",
              "assessment.improved", SOLVED),
        Entry("message", Text, "The status in words.", "message", SOLVED),
        Entry("solver_status", Text, "How the solver says that it ended.",
              "assessment.solver_status.value", SOLVED),
        Entry("exploits", Text, "Kind of the discretisation error that the optimiser found: `quadrature`, "
              "`penetration`, `friction` or `geometry`.",
              lambda s: s.assessment.costliest if s.assessment.is_exploited else None, SOLVED),
        Entry("warnings", list[str], "Signs of a wrong set-up, and of gains that are discretisation errors.",
              lambda s: list(s.warnings), SOLVED),
    ),
    "Energies and objectives": (
        Entry("energy_initial", Number, "J on the given mesh with the problem's own quadrature.",
              "energy_initial", EVERY, "energy", heading="J given,|own rule",
              digits=of_energies),
        Entry("energy", Number, "The same on the final mesh.", "energy", EVERY, "energy",
              heading="J relocated,|own rule", digits=of_energies),
        Entry("energy_initial_audited", Number, "Least continuous energy of an admissible displacement on "
              "the given mesh.", "energy_initial_audited", SOLVED, "energy", heading="J|given",
              digits=of_energies),
        Entry("energy_audited", Number, "The same on the final mesh.", "energy_audited", EVERY,
              "energy", heading="J|relocated", digits=of_energies),
        Entry("gain", Number, "Fall from `energy_initial` to `energy`.", "assessment.gain", EVERY, "energy"),
        Entry("gain_audited", Number, "Fall of the audited energy.", "assessment.gain_audited", SOLVED,
              "energy"),
        Entry("objective_initial", Number, "The minimised objective on the given mesh; absent where a new "
              "mesh was made.", _objective_initial, heading="objective|at start",
              digits=".6e"),
        Entry("objective_value", Number, "The same on the final mesh.",
              "final.objective", SOLVED, heading="objective|at end", digits=".6e"),
        Entry("gain_surviving", Number, "Gain in a quantity of the displacement on uniform refinements of "
              "the two meshes, over the gain found; a small share means that a discretisation error was "
              "minimised.", "surviving_gain.share"),
        Entry("error_reduction", Values, "Bounds of the error of the energy before and after and of "
              "their ratio, what they rest on (`source`: `exact`, `refinement` or `certified`), and the "
              "contact solves that the relocation took.",
              lambda s: s.error_reduction and s.error_reduction.record()),
        Entry("attainable_factor", Number, "By how much less the error of the best mesh of as many triangles "
              "is than that of the given mesh, estimated.", "reduced_error.attained.attainable_factor"),
        Entry("share_of_attainable", Number, "That least error over the one of the final mesh.",
              "reduced_error.attained.share_of_attainable"),
        Entry("I1", Number, "Error of the energy, a term of Theorem 4.1, where the exact solution is known.",
              unit="energy", digits=".6f"),
        Entry("I2", Number, "The same of the contact.", unit="energy", digits=".2e"),
        Entry("I3", Number, "The same of the friction.", unit="energy", digits=".2e"),
        Entry("energy_above_exact", Number, "What the terms sum to.", unit="energy",
              heading="J above|exact", digits=".6f"),
    ),
    "Displacement and mesh": (
        Entry("u_min", Number, "Least displacement component.", lambda s: float(s.displacement.min()), EVERY,
              "length", heading="u min", digits=".4g"),
        Entry("u_max", Number, "Largest displacement component.", lambda s: float(s.displacement.max()),
              EVERY, "length", heading="u max", digits=".4g"),
        Entry("min_area_ratio", Number, "Least element area over its initial value.",
              "final.min_area_ratio", EVERY,
              heading="least|area ratio", digits=".3f"),
        Entry("domain_area_change", Number, "Relative, where nodes slide along curves.",
              "assessment.domain_area_change"),
        Entry("penetration", Number, "Deepest penetration between contact nodes.",
              "final.penetration", SOLVED, "length"),
    ),
    "Contact": (
        *_contact("_initial", "the given mesh", "given.contact"),
        *_contact("", "the final mesh", "final.contact"),
        *_contact("_refined", "its refinement", "reduced_error.contact"),
        Entry("contact", dict[str, dict[str, Number]],
              "By contact boundary: `normal_force`, `tangential_force` (friction on the body along the "
              "tangents), `peak_pressure`, `contact_length`, and of an elastic body `force_x`, `force_y` and "
              "`moment` (about the origin, counter-clockwise) of the foundation on the body, pressure and "
              "friction together, of a body of revolution `force_y` along the axis (the others are 0); on "
              "the final mesh, with `_initial` on the given one, and with "
              "`_refined` where its refinement was solved ([how](theory.md#contact-results)).",
              lambda s: s.contact or None),
        Entry("pairs", dict[str, list[str]], "By the first of two boundaries in contact with each other the "
              "names of both; the second one bears the opposite force.", lambda s: s.pairs or None),
        Entry("tools", dict[str, dict[str, list[Number]]],
              "By contact boundary of a [foundation that moves](own_problems.md#tools): its `displacement`, "
              "and its `force` on the body, each along x and y.", lambda s: s.tools or None),
        Entry("sticking_nodes", Count, "With friction: nodes of the contact boundary that stick.",
              "final.sticking_nodes"),
        Entry("sliding_nodes", Count, "The same that slide.", "final.sliding_nodes"),
        Entry("coulomb_residual_initial", Number, "How far Coulomb's law is from holding along whole contact "
              "edges of the given mesh, as a part of the contact force "
              "([theory](theory.md#coulomb-friction)).", "given.coulomb_residual"),
        Entry("coulomb_residual", Number, "The same on the final mesh.",
              "final.coulomb_residual"),
    ),
    "Designs": (
        Entry("design", Named, "Of a [design](own_problems.md#designs): its variables at the end. Energies "
              "of different designs do not compare.",
              lambda s: None if s.assessment.designed is None else dict(s.design)),
        Entry("design_initial", Named, "The same at the start.",
              lambda s: _own_design(s, lambda one: one.start)),
        Entry("design_bounds", dict[str, list[Number]], "Their bounds.",
              lambda s: _own_design(s, lambda one: list(one.bounds))),
        Entry("constraints", dict[str, dict[str, Number]], "What is constrained, by its text: `value` at the "
              "end, `lower`, `upper` (null: none), `violation` over the largest bound. Of "
              "`max-pressure(NAME)` the largest mean pressure of a vertex.",
              lambda s: {text: one.record() for text, one in s.constraints.items()} or None),
    ),
    "Work": (
        Entry("iterations", Count, "Of the solver.", "trace.iterations", EVERY),
        Entry("contact_solves", Count, "Of the formulation.", "trace.work.contact_solves", EVERY),
        Entry("cold_contact_solves", Count, "Those without an active set to start from.",
              lambda s: s.trace.work.cold_contact_solves or None),
        Entry("contact_factorisations", Count, "Of the stiffness.",
              lambda s: s.trace.work.contact_factorisations or None),
        Entry("kkt_factorisations", Count, "Of KKT matrices; Ipopt's iterations, each of which takes one at "
              "least.", lambda s: s.trace.work.kkt_factorisations or None, heading="KKT|factorisations"),
        _seconds("wall_time_s", "Build, solve and audit.", "trace.wall_time_s", presence=EVERY,
                 heading="time|[s]", digits=of_seconds),
        _seconds("build_time_s", "Making models and derivatives.", "trace.build_time_s"),
        _seconds("solve_time_s", "The formulation.", "trace.solve_time_s"),
        _seconds("audit_time_s", "The assessment.", "trace.audit_time_s"),
        _seconds("contact_time_s", "One contact solve on the given mesh, the unit of cost.",
                 "trace.contact_time_s"),
    ),
    "Residuals and stationarity": (
        Entry("equilibrium_residual", Number, "Of an independent contact solve on the final mesh, over the "
              "largest force.", "final.residuals.equilibrium", EVERY,
              heading="equil.,|assessed", digits=".1e"),
        Entry("complementarity_residual", Number, "Violation of the laws of contact and friction by that "
              "solve, dimensionless.", "final.residuals.complementarity", EVERY,
              heading="compl.,|assessed", digits=".1e"),
        Entry("own_equilibrium_residual", Number, "Of the formulation's own displacement and forces.",
              "assessment.own_residuals.equilibrium", SOLVED, heading="equil.,|own", digits=".1e"),
        Entry("own_complementarity_residual", Number, "The same for complementarity.",
              "assessment.own_residuals.complementarity", SOLVED, heading="compl.,|own",
              digits=".1e"),
        Entry("stationarity", Text, "The kind that was computed: KKT, or W, C, M, S, B of an MPCC.",
              "assessment.first_order.stationarity", EVERY),
        Entry("stationarity_residual", Number, "First-order residual of the outer problem, over that on the "
              "given mesh.", "assessment.first_order.residual", SOLVED, heading="first-order|residual",
              digits=".1e"),
        Entry("label", Text, "With another objective than the energy: the kind in words."),
        Entry("b_stationary", bool | None, "Whether no branch of the contact descends; null: not decided."),
        Entry("biactive", Count, "Pairs whose members both vanish."),
        Entry("biactive_nodes", list[Any] | None, "The nodes that they belong to."),
        Entry("descent_rate", Number, "Steepest descent over the branches, relative to the largest component "
              "of the gradient on the given mesh: 0 if there is none."),
    ),
    "Certificate": (
        Entry("energy_lower_bound", Number, "Of the least energy, see [the certificate](certificate.md).",
              "certificate.lower", unit="energy", heading="lower|bound",
              digits=of_energies),
        Entry("energy_upper_bound", Number, "Of the least energy.",
              "certificate.upper", unit="energy", heading="upper|bound",
              digits=of_energies),
        Entry("error_bound_initial", Number, "Of the error on the given mesh in the energy norm.",
              "certificate.error_bound_initial", unit="energy^(1/2)"),
        Entry("error_bound", Number, "The same on the final mesh.",
              "certificate.error_bound", unit="energy^(1/2)"),
        Entry("relative_error_bound_initial", Number, "The first over the norm of the solution.",
              "certificate.relative_initial"),
        Entry("relative_error_bound", Number, "The second over it.",
              "certificate.relative"),
        Entry("guaranteed_lower", bool | None, "Whether the lower bound is one, not an estimate.",
              "certificate.guaranteed_lower"),
        Entry("guaranteed_upper", bool | None, "The same of the upper one.",
              "certificate.guaranteed_upper"),
        Entry("guaranteed_initial", bool | None, "The same of the error on the given mesh.",
              "certificate.guaranteed_initial"),
        Entry("certificate_remark", Text, "Why they are not.", _remark),
        Entry("bounds", dict[str, Values],
              "By quantity, `resultant(NAME)` of each contact boundary: that of the exact solution is at "
              "least `lower` and at most `upper` (null: no bound), `value` is the computed one; `guaranteed` "
              "whether they are bounds, not estimates ([how](certificate.md#bounds-of-contact-forces)); "
              "`within` intervals of x or y in which at least 95 % of a force acts, if not all.",
              _bounds),
    ),
    "What formulations add": (
        Entry("relaxation", Text, "Of the complementarity in `mpcc`."),
        Entry("stages", list[Values], "Of `mpcc`: its NLPs in turn."),
        Entry("equilibrium_multiplier", Number, "Of `mpcc`: the largest multiplier of the equilibrium."),
        Entry("constraint_violation", Number, "Of `mpcc`: the largest at its end, in its own units."),
        Entry("complementarity", Number, "Of `mpcc`: the largest product of a pair at its end, in its own "
              "units."),
        Entry("nlp_solves", Count, "Of `mpcc`: NLPs solved."),
        Entry("rescues", Count, "Of `mpcc`: those after a stage had failed."),
        Entry("newton_steps", Count, "Of `joint`: steps on the reduced energy after Ipopt had stopped near a "
              "stationary point; absent if none."),
        Entry("outer", Text, "The outer solvers that `nested` used and why they stopped early, or what "
              "`auto` ran."),
        Entry("regularisation", float | list[float], "[Without move "
              "limits](without_move_limits.md#how-it-works): weight of the distortion."),
        Entry("distortion", Text, "Its kind."),
        Entry("regularisation_weight", Number, "The last weight in units of the energy.", unit="energy"),
        Entry("gain_estimate", Number, "Estimated error of the energy on the given mesh.", unit="energy"),
        Entry("cascade", list[Values], "What was done on each mesh, coarsest first."),
        Entry("start_seeds", list[Count], "With `--starts`: the seed of each; null for the given mesh."),
        Entry("start_energies", list[Number], "Energy that each one reached.", unit="energy"),
        Entry("start_values", list[Number] | None, "Value that each one reached, of another objective."),
        Entry("start_spread", Number, "The largest less the least."),
        Entry("estimates", dict[str, Values],
              "By quantity: the best known `value`, its estimated `error`, the `computed` value, whether it "
              "`converges`, and where asked for `lower`, `upper` and whether they are `guaranteed` "
              "([how](accuracy.md)); after other formulations than `adaptive` of the energy and of contact "
              "forces, on the final mesh."),
        Entry("meshes", list[Values], "Of `adaptive`: `nodes`, `seconds` so far and `quantities` "
              "like `estimates`, mesh by mesh."),
        Entry("steps", list[dict[str, dict[str, Number]]],
              "With load steps: what each contact boundary carries after each."),
        Entry("estimates_remark", Text, "Why there are no more."),
        Entry("remeshed_nodes", list[int], "With `--remesh`: nodes of the meshes that Mmg made in turn."),
        Entry("remeshed_energies", list[Number], "Energies on them before any node moved.", unit="energy"),
    ),
    "What comparisons and studies add": (
        Entry("variant", Text, "In a study the name of its table, `[formulations.NAME]`; in a comparison of "
              "objects the formulation with its settings."),
        Entry("family", Text, "In a study, what the problem is one of."),
        Entry("asked", Values, "What was asked for where something else was solved: `auto` chose, or "
              "the quadrature was raised."),
        Entry("repeat", Count, "In a study the number of the repetition, from 0."),
        Entry("repeats", Count, "With `--repeats`: how many; the times are medians."),
        *(Entry(f"{part}_time_range_s", list[float], f"The least and the largest `{part}_time_s`.", unit="s")
          for part in ("build", "solve", "audit", "wall", "contact")),
        _seconds("first_cost_s", "Build and solve of the first repetition, whose history is kept.", None,
                 presence=KNOWN),
        _seconds("task_time_s", "In a study, wall time of the whole row.", None, presence=KNOWN),
        _seconds("cpu_time_s", "In a study, processor time of the whole row.", None, presence=KNOWN),
        Entry("shared", bool, "In a study, whether the solve shared its core with something."),
        Entry("worker", Text, "In a study, the process that solved it."),
    ),
}
# fmt: on
"""All entries, by the sections of docs/records.md."""

ENTRIES = {entry.name: entry for section in SECTIONS.values() for entry in section}
"""All entries by their names."""
