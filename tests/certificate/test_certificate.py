"""What a certificate says: bounds of the error that hold, and a guarantee only where both bounds have one."""

import json
from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import meshio
import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.certificate import bracket as bracketing
from rmesh_nlp.certificate.bracket import Bracket
from rmesh_nlp.certificate.equilibration import EquilibratedField, Guess
from rmesh_nlp.cli.app import run
from rmesh_nlp.contact.solver import ContactSolver
from rmesh_nlp.io.results import read_results
from rmesh_nlp.io.vtu import read_vtu
from rmesh_nlp.problem import ContactProblem, Dirichlet, Laplace, Motion, Obstacle, PlaneStrain
from rmesh_nlp.report.blocks import blocks
from rmesh_nlp.report.figures import block_figures
from rmesh_nlp.report.style import Page
from rmesh_nlp.solving import certify as certifying
from rmesh_nlp.solving.assess import assess
from rmesh_nlp.solving.certify import bounded, certified, certify
from rmesh_nlp.solving.parts import Certificate
from support.designs import BOW, E, block
from support.formulations import fixed
from support.problem_files import VALID
from support.solved import solved

SIDES = ("left", "right", "top", "bottom")
TORSION = -0.5 * 0.0351442538  # least energy of -laplace u = 1 on the unit square: the series for its torsion


@cache
def membrane() -> rm.Solution:
    return fixed.solve(ContactProblem(rm.shapes.rectangle(3, 3), Laplace(1.0), SIDES))


def test_the_error_bound_is_one_and_close_where_the_error_is_known() -> None:
    solution = membrane()
    error = np.sqrt(2 * (solution.energy - TORSION))  # without contact the norm of the error is exactly this
    found = certify(solution)
    assert error <= found.error_bound <= 1.05 * error
    assert found.relative == pytest.approx(found.error_bound / np.sqrt(-2 * solution.energy))


@pytest.mark.slow
def test_the_error_bound_is_one_of_the_computed_displacement_under_a_coarse_rule_too() -> None:
    """The admissible displacement, whose energy is the upper bound, is found by an accurate rule."""
    source = Laplace(lambda x, y: 10 * np.pi**2 * ca.sin(3 * np.pi * x) * ca.sin(np.pi * y))
    problem = ContactProblem(rm.shapes.rectangle(2, 2), source, SIDES, quadrature="midpoint")
    solution, model = fixed.solve(problem), ContactSolver(problem.with_rule(25))
    u = solution.displacement.T.ravel()[model.displacement.index.T.ravel() >= 0]
    error = np.sqrt(2 * (model.system(problem.mesh.p).energy(u) + 10 * np.pi**2 / 8))
    found = certify(solution)
    assert np.sqrt(2 * found.gaps[1]) < error <= found.error_bound < 1.5 * error


def test_the_error_bound_counts_the_way_to_a_displacement_on_a_refined_mesh() -> None:
    """All nodes of the triangle under the hill are held at zero, and so is the computed displacement."""
    hill = Obstacle.interior(lambda x, y: 0.02 - ((x - 0.2) ** 2 + (y - 0.2) ** 2) / 2)
    problem = ContactProblem(rm.shapes.rectangle(2, 2, diagonal="falling"), Laplace(0.0), SIDES, hill)
    solution = fixed.solve(problem)
    found, admissible = certify(solution, refinements=0), solution.assessment.final.continuous
    assert admissible.problem.mesh.nelements > problem.mesh.nelements
    way = np.sqrt(2 * admissible.strain)
    assert found.error_bound >= (way + np.sqrt(2 * found.gaps[1])) * (1 - 1e-12)
    force = found.bounds["resultant(interior)"]
    assert force.value == 0 < force.upper  # that of the given mesh


def relocated(
    patch: pytest.MonkeyPatch, before: Bracket, after: Bracket, stretch: float = 0.0, **found: Any
) -> Certificate:
    """Of nodes that moved, with these brackets and such admissible displacements, by default none.

    The body grows by the part ``stretch``.
    """
    solution = membrane()
    assessment, nodes = solution.assessment, solution.mesh.p * (1 + stretch)
    nodes[:, solution.mesh.interior_nodes()] += 0.01
    state = replace(assessment.final.continuous.state, status=rm.Status.INACCURATE)
    continuous = replace(assessment.final.continuous, **{"state": state, **found})
    given = replace(assessment.given, continuous=continuous)
    final = replace(given, mesh=replace(solution.mesh, doflocs=nodes))
    patch.setattr(
        certifying, "refined_bracket", lambda _, where, *__: after if np.array_equal(where, nodes) else before
    )
    return certify(replace(solution, assessment=replace(assessment, given=given, final=final)))


KNOWN = Bracket(-0.02, 0.18, (), (), np.zeros(0), np.zeros(0), 1.0, 0.0)
FAULTS = ("crude",)


@pytest.mark.parametrize("unknown", ["none", "lower", "upper before", "upper after"])
def test_a_guarantee_needs_both_bounds_on_both_meshes(unknown: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lower bound serves both meshes."""
    lower = replace(KNOWN, lower_faults=FAULTS if unknown == "lower" else ())
    before = replace(lower, upper_faults=FAULTS if unknown == "upper before" else ())
    after = replace(lower, upper=0.02, upper_faults=FAULTS if unknown == "upper after" else ())
    found = relocated(monkeypatch, before, after)
    assert (found.lower, found.upper) == (-0.02, 0.02)
    assert found.guaranteed_lower is (unknown != "lower")
    assert found.guaranteed_upper is (unknown != "upper after")
    assert found.guaranteed_initial is (unknown not in ("lower", "upper before"))


@pytest.mark.parametrize("stretch", [0.0, 0.3])
def test_the_lower_bound_is_the_better_guaranteed_one_of_the_same_domain(monkeypatch, stretch: float) -> None:
    found = relocated(monkeypatch, replace(KNOWN, lower=-0.5), replace(KNOWN, lower_faults=FAULTS), stretch)
    assert (found.lower, found.guaranteed_lower) == ((-0.02, False) if stretch else (-0.5, True))


def test_the_upper_bound_is_an_admissible_energy_with_its_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    crude = replace(KNOWN, upper=0.9, upper_faults=FAULTS)
    found = relocated(monkeypatch, crude, crude)
    assert (found.upper, found.guaranteed_upper) == (0.9, False)
    state = membrane().assessment.final.continuous.state
    found = relocated(monkeypatch, crude, crude, state=state, energy=0.3, doubt=0.2)
    assert (found.upper, found.guaranteed_upper) == (0.5, True)


@pytest.mark.parametrize("crest", [0.2, 1.2])
def test_a_foundation_that_rises_through_a_held_edge_leaves_no_upper_bound(crest: float) -> None:
    mesh = rm.shapes.rectangle(2, 1, x=(0, 2)).with_boundaries({"part": lambda x: (x[1] == 0) & (x[0] < 1)})
    foundation = Obstacle.graph("bottom", lambda x, y: -1 + crest * ca.fmax(0, 1 - 9 * abs(x - 0.4)))
    law = PlaneStrain.from_young(100.0, 0.3, (0.0, -1.0))
    found = certify(fixed.solve(ContactProblem(mesh, law, (Dirichlet("part", (0.0, 0.0)),), foundation)))
    assert (found.guaranteed_lower, found.guaranteed_upper) == (True, crest < 1)


def test_bounds_that_contradict_each_other_are_withdrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    above = replace(KNOWN, lower=0.3)
    found = relocated(monkeypatch, above, above)
    assert not found.guaranteed_lower
    assert not found.guaranteed_upper
    assert not found.guaranteed_initial
    assert "contradicts" in found.why
    assert np.isnan(found.error_bound)
    assert "no error bound" in found.sentence
    assert not any(bounds.guaranteed for bounds in found.bounds.values())


@pytest.mark.slow
@pytest.mark.parametrize("residual", [1e-6, float("nan")])
def test_a_field_out_of_equilibrium_proves_nothing(residual: float, monkeypatch: pytest.MonkeyPatch) -> None:
    build = bracketing.equilibrated
    monkeypatch.setattr(bracketing, "equilibrated", lambda *given: replace(build(*given), residual=residual))
    found = certify(solved("fixed", "6.1", 3))
    assert not found.guaranteed_lower
    assert not found.bounds["resultant(contact)"].guaranteed
    assert "out of equilibrium" in found.why
    assert "estimated" in found.sentence


@pytest.mark.parametrize("wrong", ["residual", "forces", "given"])
def test_the_bound_falls_by_what_forces_and_given_displacements_may_be_wrong_by(wrong, monkeypatch) -> None:
    """Of u = x, whose energy is 1/2: reactions work 1 on the given displacements."""
    ends = Dirichlet("left", (0.0,)), Dirichlet("right", (1.0,))
    problem, build = ContactProblem(rm.shapes.rectangle(2, 2), Laplace(0.0), ends), bracketing.equilibrated

    def spoilt(*given: Any) -> EquilibratedField:
        field = build(*given)
        assembled = field.balance.assembled
        doubtful = replace(assembled, conditions=replace(assembled.conditions, given_doubt=1e-3))
        changes = {
            "residual": {"residual": 1e-3},
            "forces": {"forces": field.forces + 1e-3},  # those of both sides of an edge have opposite signs
            "given": {"balance": replace(field.balance, assembled=doubtful)},
        }
        return replace(field, **changes[wrong])

    guess = Guess(problem.mesh.p[:1], *np.zeros((2, problem.mesh.p.shape[1])))
    assert bracketing.bracket(problem, problem.mesh.p, guess).lower == pytest.approx(0.5)
    monkeypatch.setattr(bracketing, "equilibrated", spoilt)
    assert bracketing.bracket(problem, problem.mesh.p, guess).lower < 0.5 - 0.9e-3


@pytest.mark.slow
def test_bounds_of_two_designs_are_those_of_two_problems() -> None:
    problem = replace(block(E, BOW, n=(3, 1)), motion=Motion(0))
    outer = rm.Outer.of(problem, "area")
    found = assess(outer, rm.Outcome(outer, np.array([0.8, -0.5]), rm.Status.CONVERGED))
    both = bounded(found, refinements=0)
    first, last = (
        certify(fixed.solve(replace(problem.at_design(design), constraints=())), refinements=0)
        for design in (None, found.final.design)
    )
    assert both.relative_initial == pytest.approx(first.relative, rel=1e-6)
    assert both.relative == pytest.approx(last.relative, rel=1e-6)
    assert first.lower != pytest.approx(last.lower, rel=1e-2)  # so that neither serves the other


@pytest.mark.slow
def test_a_body_with_curves_has_no_certificate_at_order_2() -> None:
    """Its displacement is of the body, and the bounds would be those of a polygon."""
    problem = ContactProblem(
        rm.shapes.plate_with_hole(5.0),
        Laplace(1.0),
        ("left",),
        motion=Motion(None, curves={"hole": rm.Circle((5.0, 5.0), 2.5)}),
    )
    assert certify(fixed.solve(problem)).guaranteed_lower
    found, remark = certified(fixed.solve(replace(problem, order=2)).assessment)
    assert found is None
    assert "polygon" in remark
    assert "take order = 1" in remark


@pytest.mark.slow
def test_console_record_and_file_hold_the_certificate_and_figures_show_it(tmp_path, capsys) -> None:
    assert run(["solve", "6.3", "--n", "4x2", "--certify", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "error in the energy norm at most" in printed
    assert "least energy between" in printed
    record = json.loads((tmp_path / "record.json").read_text())
    assert record["energy_lower_bound"] < record["energy"] == pytest.approx(record["energy_upper_bound"])
    assert record["error_bound"] < record["error_bound_initial"]
    assert record["guaranteed_lower"] is record["guaranteed_upper"] is True
    (force,) = record["bounds"].values()
    assert 0 < force["lower"] < force["value"]
    assert force["upper"] is None  # the foundation touches a support
    assert force["guaranteed"] is True
    cells = meshio.read(tmp_path / "solution.vtu").cell_data
    assert cells["equilibrated_stress"][0].shape == (record["triangles"], 3)
    # the lower bound may be the better one of the other mesh
    assert np.sum(cells["error_bound"][0]) >= 0.5 * record["error_bound"] ** 2 - 1e-12
    assert read_vtu(tmp_path / "solution.vtu").error_bound is not None
    results = read_results(tmp_path)
    figures = dict(block_figures(blocks([result.record for result in results])[0], results, Page()))
    (error,) = [figure for name, figure in figures.items() if name.endswith("-error")]
    titles = [axis.get_title() for axis in error.axes]
    assert "given, error at most" in titles[0]
    assert "relocated, error at most" in titles[1]


@pytest.mark.slow
def test_why_there_is_no_certificate_is_printed(tmp_path, capsys) -> None:
    (tmp_path / "my.toml").write_text(VALID.replace("friction =", "coulomb ="))
    options = ["-f", "fixed", "--certify", "--no-figures", "--out", str(tmp_path / "o")]
    assert run(["solve", str(tmp_path / "my.toml"), *options]) == 0
    assert "no certificate: with Coulomb friction" in capsys.readouterr().out
    assert "energy_lower_bound" not in json.loads((tmp_path / "o" / "record.json").read_text())
