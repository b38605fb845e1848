"""What a certificate says: bounds of the error that hold, and a guarantee only where both bounds have one."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from rmesh_nlp.assessment.error_reduction import ErrorReduction
from rmesh_nlp.certificate import bracket as bracketing
from rmesh_nlp.certificate.bracket import Bracket
from rmesh_nlp.meshes.curves import Circle
from rmesh_nlp.meshes.shapes import plate_with_hole, rectangle
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Laplace, Motion
from rmesh_nlp.solving import certify as certifying
from rmesh_nlp.solving.assess import assess
from rmesh_nlp.solving.certify import bounded, certified, certify
from rmesh_nlp.solving.outcome import Outcome
from rmesh_nlp.solving.outer import Outer
from rmesh_nlp.solving.solution import Solution
from support.designs import BOW, E, block
from support.formulations import fixed

SIDES = ("left", "right", "top", "bottom")
TORSION = -0.5 * 0.0351442538  # least energy of -laplace u = 1 on the unit square: the series for its torsion
CLAIM = ErrorReduction((0.2, 0.4), (0.1, 0.3), 1.3, 3.0, "refinement", nodes=9, contact_solves=3)


def membrane() -> Solution:
    return fixed.solve(ContactProblem(rectangle(3, 3), Laplace(1.0), SIDES))


def relocated(solution: Solution) -> Solution:
    """As if the nodes had moved."""
    assessment, nodes = solution.assessment, np.array(solution.mesh.p)
    nodes[:, solution.mesh.interior_nodes()] += 0.01
    final = replace(assessment.final, mesh=replace(solution.mesh, doflocs=nodes))
    return replace(solution, assessment=replace(assessment, final=final))


def test_the_error_bound_is_one_and_close_where_the_error_is_known() -> None:
    solution = membrane()
    error = np.sqrt(2 * (solution.energy - TORSION))  # without contact the norm of the error is exactly this
    found = certify(solution)
    assert error <= found.error_bound <= 1.05 * error
    assert found.relative == pytest.approx(found.error_bound / np.sqrt(-2 * solution.energy))


@pytest.mark.parametrize("known", list(itertools.product([True, False], repeat=3)))
def test_a_guarantee_needs_both_bounds_on_both_meshes(
    known: tuple[bool, bool, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    """``known``: the lower bound, which serves both meshes, and the upper ones before and after."""
    lower, before, after = known
    solution, none = membrane(), np.zeros(0)
    moved = relocated(solution)
    monkeypatch.setattr(certifying, "_with_upper", lambda found, _: found)

    def bounds(_: ContactProblem, where: np.ndarray, *__: object) -> Bracket:
        is_moved = bool(np.any(where != solution.mesh.p))
        upper, known_upper = (0.02, after) if is_moved else (0.18, before)
        return Bracket(-0.02, upper, lower, known_upper, (), none, none, 1.0, 0.0)

    monkeypatch.setattr(certifying, "refined_bracket", bounds)
    found = certify(moved)
    assert (found.guaranteed_lower, found.guaranteed_upper) == (lower, after)
    assert found.guaranteed_initial is (lower and before)
    assert ("at most" in found.sentence) is all(known)
    claim = found.of_reduction(CLAIM)
    assert (claim.source == "certified") is all(known)
    if all(known):  # energies 0.2 and 0.04 above the lower bound
        assert claim.factor == pytest.approx(5.0)
        assert claim.error_initial == pytest.approx((0.16, 0.2))
        assert claim.error == pytest.approx((0.0, 0.04))


def test_a_guaranteed_lower_bound_is_better_than_a_higher_one_without(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solution, none = membrane(), np.zeros(0)
    moved = relocated(solution)
    monkeypatch.setattr(certifying, "_with_upper", lambda found, _: found)

    def bounds(_: ContactProblem, where: np.ndarray, *__: object) -> Bracket:
        known = not np.any(where != solution.mesh.p)
        return Bracket(-0.5 if known else -0.02, 0.1, known, True, (), none, none, 1.0, 0.0)

    monkeypatch.setattr(certifying, "refined_bracket", bounds)
    found = certify(moved)
    assert (found.lower, found.guaranteed_lower) == (-0.5, True)


@pytest.mark.parametrize(("status", "upper"), [(Status.CONVERGED, 0.5), (Status.INACCURATE, 0.9)])
def test_the_upper_bound_is_an_admissible_energy_with_its_doubt(status: Status, upper: float) -> None:
    none = np.zeros(0)
    one = Bracket(-0.02, 0.9, True, False, ("upper: a crude one",), none, none, 1.0, 0.0)
    found = SimpleNamespace(status=status, energy=0.3, doubt=0.2)
    bounds = certifying._with_upper(one, found)
    assert (bounds.upper, bounds.guaranteed_upper) == (upper, status is Status.CONVERGED)


@pytest.mark.parametrize("residual", [1e-6, float("nan")])
def test_a_field_out_of_equilibrium_proves_nothing(residual: float, monkeypatch: pytest.MonkeyPatch) -> None:
    build = bracketing.equilibrated_flux
    monkeypatch.setattr(
        bracketing, "equilibrated_flux", lambda *given: replace(build(*given), residual=residual)
    )
    found = certify(membrane())
    assert not found.guaranteed_lower
    assert "out of equilibrium" in found.why
    assert "estimated" in found.sentence


def test_bounds_of_two_designs_are_those_of_two_problems() -> None:
    problem = replace(block(E, BOW), motion=Motion(0))
    outer = Outer.of(problem, "area")
    found = assess(outer, Outcome(outer, np.array([0.8, -0.5]), Status.CONVERGED))
    both = bounded(found, refinements=0)
    first, last = (
        certify(fixed.solve(replace(problem.at_design(design), constraints=())), refinements=0)
        for design in (None, found.final.design)
    )
    assert both.relative_initial == pytest.approx(first.relative, rel=1e-6)
    assert both.relative == pytest.approx(last.relative, rel=1e-6)
    assert first.lower != pytest.approx(last.lower, rel=1e-2)  # so that neither serves the other


def test_a_body_with_curves_has_no_certificate_at_order_2() -> None:
    """Its displacement is of the body, and the bounds would be those of a polygon."""
    problem = ContactProblem(
        plate_with_hole(3.0),
        Laplace(1.0),
        ("left",),
        motion=Motion(None, curves={"hole": Circle((5.0, 5.0), 2.5)}),
    )
    assert certify(fixed.solve(problem)).guaranteed_lower
    found, remark = certified(fixed.solve(replace(problem, order=2)).assessment)
    assert found is None
    assert "polygon" in remark
    assert "take order = 1" in remark
