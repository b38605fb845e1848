"""Starts, what is assessed of an end, and what follows: valid, improved, stationary."""

import signal
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

import rmesh_nlp as rm
from rmesh_nlp.assessment.admissible import Admissible
from rmesh_nlp.assessment.measures import EXPLOITS, ContactResiduals, residuals
from rmesh_nlp.contact.system import ContactSystem, OwnState
from rmesh_nlp.evaluation import Array
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.models.reduced_model import ReducedPoint
from rmesh_nlp.optimize.status import Status
from rmesh_nlp.problem import ContactProblem, Laplace, Motion, PlaneStrain
from rmesh_nlp.solving import driver
from rmesh_nlp.solving.assessment import EXPLOITED, FAILURES
from rmesh_nlp.solving.outer import Outer
from support.conclusions import BROKEN, compared
from support.endings import Ends, ended
from support.solved import solve_once, solved

NAN = float("nan")
STILL = {"stationary": False, "gain": 0.0, "gain_audited": 0.0, "decrease": 0.0}
ON_THE_WAY = {"stationary": False}
LIMITS = (Status.TIME_LIMIT, Status.ITERATION_LIMIT, Status.INTERRUPTED, Status.STALLED)
OTHERS = (Status.CYCLED, Status.INACCURATE, Status.INVALID_MESH)
TOO_LARGE = [ContactResiduals(*both) for both in ((2e-6, 0.0), (NAN, 0.0), (0.0, 2e-6), (0.0, NAN))]
FALL = ("gain", "gain_audited", "decrease")


CONCLUSIONS: dict[str, list[tuple[Status, dict[str, Any], Status]]] = {
    "not valid": [
        (Status.CONVERGED, {"min_area_ratio": 0.0}, Status.INVALID_MESH),
        (Status.CONVERGED, {"contact": Status.CYCLED}, Status.CYCLED),
        # the solver's own displacement does not solve the contact problem
        (Status.CONVERGED, {"own": BROKEN}, Status.INACCURATE),
        *((Status.CONVERGED, {"residuals": large}, Status.INACCURATE) for large in TOO_LARGE),
        (Status.CONVERGED, {"gain": NAN}, Status.EVALUATION_ERROR),
    ],
    "not improved": [
        (Status.CONVERGED, {"gain_audited": -1e-8, "decrease": -1e-8}, Status.EXPLOITED),
        (Status.CONVERGED, {"gain": 0.0, "gain_audited": -1e-8, "decrease": 0.1}, Status.EXPLOITED),
        (Status.CONVERGED, dict.fromkeys(FALL, -0.1), Status.WORSE),
        (Status.CONVERGED, {"is_energy": False, "decrease": -1e-8}, Status.WORSE),
        # the energy of the displacement in the files is above that of the given mesh
        (Status.CONVERGED, {"gain": -0.1, "audited_above": -0.1 - 1e-8}, Status.WORSE),
        (Status.CONVERGED, {"size": 1e-6, **dict.fromkeys(FALL, -5e-15)}, Status.WORSE),
        (Status.CONVERGED, {"size": 1e6, **dict.fromkeys(FALL, -5e-3)}, Status.WORSE),
    ],
    "success": [
        *((said, {}, Status.CONVERGED) for said in Status),  # stationary, whatever the solver says
        *((said, ON_THE_WAY, Status.NOT_STATIONARY) for said in (Status.CONVERGED, Status.ACCEPTABLE)),
        *((said, ON_THE_WAY, said) for said in LIMITS),
        # a point where a limit stopped a solver need not be a solution of its program
        (Status.TIME_LIMIT, {"own": BROKEN, **ON_THE_WAY}, Status.TIME_LIMIT),
        # a better mesh is never called infeasible: it is one at which the solver got stuck
        *((said, ON_THE_WAY, Status.STALLED) for said in (*FAILURES, *OTHERS)),
        (Status.FAILED, {**ON_THE_WAY, "decrease": 2e-8, "size": 10.0}, Status.STALLED),
        # another objective may be lowered at the cost of the energy
        (Status.CONVERGED, {"is_energy": False, "gain": -1.0}, Status.CONVERGED),
        # differences of rounding are none, relative to the objective's size, whatever its unit
        *(
            (Status.CONVERGED, {"size": unit, **dict.fromkeys(FALL, -5e-10 * unit)}, Status.CONVERGED)
            for unit in (1e-6, 1.0, 1e6)
        ),
    ],
    "no success": [
        *((said, STILL, said) for said in FAILURES),
        *((said, STILL, Status.FAILED) for said in OTHERS),
        (Status.FAILED, {**ON_THE_WAY, "decrease": 5e-9, "size": 10.0}, Status.FAILED),
    ],
}


@pytest.mark.parametrize("kind", CONCLUSIONS)
def test_what_follows_from_measurements(kind: str) -> None:
    for said, figures, status in CONCLUSIONS[kind]:
        found, valid, improved = compared(said, **figures), kind != "not valid", kind != "not improved"
        assert (found.status, found.valid, found.success) == (status, valid, kind == "success"), figures
        assert found.improved == improved or not valid, figures


def test_a_rise_of_a_distortion_that_was_zero_is_measured_in_units_of_its_density() -> None:
    outer = Outer.of(rm.EXAMPLES["6.1"](2), "3*elastic")
    found = ended(outer, np.zeros(outer.n))
    assert found.given.objective_audited == 0
    for rise, improved in ((1e-17, True), (2e-9, True), (4e-9, False)):
        risen = replace(found.final, objective_audited=rise)
        assert replace(found, final=risen).improved is improved
    broken = replace(found.given, violation=1e-3)  # any point that obeys the constraints is better
    assert replace(found, given=broken, final=replace(found.final, objective_audited=1.0)).improved


@pytest.mark.parametrize("name", EXPLOITS)
def test_what_was_exploited_is_the_correction_that_costs_most(name: str) -> None:
    corrections = {**dict.fromkeys(EXPLOITS, 0.01), name: 0.2}
    rose = {"gain_audited": -0.1, "decrease": -0.1, "corrections": corrections}
    found = compared(**rose)
    assert (found.is_exploited, found.costliest) == (True, name)
    assert found.message.endswith(EXPLOITED[name].format(remedy="smaller elements there"))
    assert not compared(**{**rose, "gain_audited": 0.1, "decrease": 0.1}).is_exploited
    worse = compared(**rose, gain=-0.05)  # one's own measure says the same: the mesh is worse
    assert (worse.is_exploited, worse.status) == (False, Status.WORSE)


@pytest.mark.parametrize("given_is_sick", [True, False])
def test_a_contact_solve_of_the_assessment_that_failed_is_a_fault(given_is_sick, monkeypatch) -> None:
    """Of either mesh: a gain is a difference of four of them."""
    outer = Outer.of(rm.EXAMPLES["6.2"]((4, 2)))
    found, q = outer.initial, np.full(outer.n, 0.01)
    sick = replace(found, state=replace(found.state, status=Status.CYCLED))

    def continuous(_: Outer, q: Array) -> Admissible:
        return found if bool(np.any(q)) is given_is_sick else sick

    monkeypatch.setattr(Outer, "continuous", continuous)
    judged = ended(outer, q)
    assert (judged.status, judged.valid, judged.success) == (Status.CYCLED, False, False)


def pressed(*_: Any) -> Any:
    signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("sign", [0.0, 1.0])
@pytest.mark.parametrize("when", ["during", "after"])
def test_ctrl_c_hides_no_fault_and_no_fault_hides_it(sign, when, monkeypatch) -> None:
    """``during`` the solve the mesh as given takes the place of a worse end, ``after`` it the audit ends."""

    def end(outer: Outer, q: Array, monitor: rm.Monitor) -> rm.Outcome:
        to = q + 0.5 * sign * np.sign(outer.energy(q).gradient) * outer.discretisation.mesh_map.upper
        if when == "during":
            monitor.attempt(pressed)
        else:
            assess = driver.assess
            monkeypatch.setattr(driver, "assess", lambda *a, **k: pressed() or assess(*a, **k))
        return rm.Outcome(outer, to, Status.CONVERGED)

    found = solve_once(rm.EXAMPLES["6.2"]((4, 2)), Ends(end))
    good = when == "during"
    assert (found.status, found.success, found.assessment.improved) == (Status.INTERRUPTED, good, good)
    assert ("no success, unaudited" in found.message) == (not good)
    assert found.message.startswith(Status.INTERRUPTED.message)


SYSTEM = ContactSystem(
    stiffness=sp.csc_array(np.diag([10.0, 20.0, 30.0])),
    load=np.array([8.0, 0.0, 0.0]),
    constant=0.0,
    normals=sp.csr_array(np.array([[0.0, 1.0, 0.0]])),
    tangents=sp.csr_array(np.array([[0.0, 0.0, 1.0]])),
    offset=np.array([0.5]),
    slip_bound=np.array([4.0]),
    frictional=np.ones(1, dtype=bool),
)
"""The largest applied force, the unit of forces, is 8."""

SMOOTH = replace(SYSTEM, slip_bound=np.zeros(1), frictional=np.zeros(1, dtype=bool))


def law(gap: float, force: float, slip: float = 0.0, friction: float = 0.0, system: Any = SYSTEM) -> float:
    """With the largest displacement 2."""
    u = np.array([2.0, gap - 0.5, slip])
    state = OwnState(u, np.array([force]), np.array([friction]))
    return residuals(system, state).complementarity


@pytest.mark.parametrize(
    ("gap", "force", "residual"),
    [
        (0.0, 3.0, 0.0),  # touches
        (0.7, 0.0, 0.0),  # open
        (-0.1, 3.0, 0.05),  # penetrates by a twentieth of the largest displacement
        (-0.1, 0.0, 0.05),
        (0.7, -0.4, 0.05),  # pulls with a twentieth of the largest force
        (0.2, 0.4, 0.05),  # both: the smaller one
        (0.05, 4.0, 0.025),
    ],
)
def test_the_contact_law(gap: float, force: float, residual: float) -> None:
    assert law(gap, force, system=SMOOTH) == pytest.approx(residual, abs=1e-15)
    assert law(gap, force, 0.0, 1.0) == pytest.approx(residual, abs=1e-15)  # sticks within the bound


@pytest.mark.parametrize(
    ("slip", "friction", "residual"),
    [
        (0.0, 3.9, 0.0),  # sticks
        (1.0, -4.0, 0.0),  # slides against the friction
        (-1.0, 4.0, 0.0),
        (2.0, 4.0, 1.0),  # is pulled along: 4 + 4 in units of 8
        (1.0, 0.0, 0.5),  # slides without friction: 4 of 8
        (0.25, -3.0, 0.125),  # slip 0.25 / 2 * 8 = 1, less than the reserve of the friction
        (0.0, 5.0, 0.125),  # above the bound
    ],
)
def test_the_friction_law(slip: float, friction: float, residual: float) -> None:
    assert law(0.0, 3.0, slip, friction) == pytest.approx(residual, abs=1e-15)


def test_the_worst_of_both_laws_counts() -> None:
    assert ContactResiduals(1e-6, 1e-6).hold  # what the documents promise
    assert not ContactResiduals(0.0, 1.01e-6).hold
    assert law(-0.1, 3.0, 1.0, 0.0) == pytest.approx(0.5)
    assert law(-1.4, 3.0, 1.0, 0.0) == pytest.approx(0.7)
    assert np.isnan(law(0.0, 3.0, 0.0, NAN))
    none, no_rows = np.zeros(0), sp.csr_array((0, 3))
    nothing = replace(SYSTEM, normals=no_rows, tangents=no_rows, offset=none, slip_bound=none)
    assert residuals(nothing, OwnState(np.ones(3), none, none)).complementarity == 0


def test_a_body_at_rest_is_measured_too() -> None:
    """Nothing moves: without gap and force the laws hold, with a force of 8 across a gap they do not."""
    for gap, force, residual in ((0.0, 0.0, 0.0), (1e-6, 8.0, 1.0)):
        rest = replace(SMOOTH, offset=np.full(1, gap))
        state = OwnState(np.zeros(3), np.full(1, force), np.zeros(1))
        assert residuals(rest, state).complementarity == pytest.approx(residual)


@pytest.mark.parametrize(
    ("load", "normal", "friction", "residual"),
    [(8.0, 3.0, 2.0, 12 / 8), (20.0, 3.0, 2.0, 7 / 20), (20.0, 10.0, 2.0, 4 / 20), (20.0, 10.0, 6.0, 0.0),
     (20.0, 10.0, None, 6 / 20)],
)  # fmt: skip
def test_equilibrium_is_the_largest_force_out_of_balance(load, normal, friction, residual) -> None:
    """K u - F - N^T lambda - T^T tau by hand: (20 - F, 10 - lambda, 6 - tau) over F."""
    system = replace(SMOOTH if friction is None else SYSTEM, load=np.array([load, 0.0, 0.0]))
    state = OwnState(np.array([2.0, 0.5, 0.2]), np.array([normal]), np.array([friction or 0.0]))
    assert residuals(system, state).equilibrium == pytest.approx(residual, abs=1e-15)


@pytest.fixture(scope="module")
def outer() -> Outer:
    return Outer.of(rm.EXAMPLES["6.3"]((4, 2)))


@pytest.mark.parametrize("step", [-1e-3, 1e-3])
def test_of_an_all_at_once_solver_the_last_iterate_is_kept_only_if_it_is_below_the_start(outer, step) -> None:
    start, track = np.zeros(outer.n), rm.Monitor().track(outer)
    gradient = outer.energy(start).gradient
    q = step * gradient / np.max(np.abs(gradient))
    track(1, np.append(q, np.zeros(outer.relocation.parts.n_u)), 0.0, np.zeros(0))
    np.testing.assert_array_equal(track.best(start), q if step < 0 else start)


def test_an_iterate_whose_elements_are_inverted_is_never_kept() -> None:
    wide = Outer.of(ContactProblem(rectangle(3, 3), Laplace(1.0), ("left",), motion=Motion(2.0)))
    start, track = np.zeros(wide.n), rm.Monitor().track(wide)
    folded = np.random.default_rng(5).uniform(-1, 1, wide.n)
    assert not wide.is_valid(folded)
    here = wide.energy(start)
    for iteration, (q, value) in enumerate([(start, here.value), (folded, here.value - 1.0)]):
        track.exact(iteration, q, replace(here, value=value))
    np.testing.assert_array_equal(track.best(folded), start)


def area_ratio(problem: ContactProblem, nodes: np.ndarray) -> float:
    """The least one, by the shoelace formula."""

    def areas(points: np.ndarray) -> np.ndarray:
        (x0, y0), (x1, y1), (x2, y2) = (points[:, corner] for corner in problem.triangles)
        return (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)

    return float(np.min(areas(nodes) / areas(problem.mesh.p)))


class TestStart:
    def test_it_is_the_mesh_as_given_or_drawn_uniformly_from_the_move_limits(self, outer: Outer) -> None:
        np.testing.assert_array_equal(outer.variables(), np.zeros(outer.n))
        for seed in (0, 3):
            drawn = np.random.default_rng(seed).uniform(-1, 1, outer.n)
            np.testing.assert_array_equal(outer.variables(seed=seed), drawn)

    def test_positions_are_cut_to_the_move_limits(self, outer: Outer) -> None:
        q = np.random.default_rng(1).uniform(-1.5, 1.5, outer.n)
        start = outer.variables(outer.nodes(q), 7)  # a seed has then no effect
        np.testing.assert_allclose(start, np.clip(q, -1, 1), atol=1e-12)
        np.testing.assert_allclose(outer.discretisation.mesh_map.upper, 1)

    def test_what_inverts_elements_is_shortened(self) -> None:
        wide = Outer.of(ContactProblem(rectangle(3, 3), Laplace(1.0), ("left",), motion=Motion(2.0)))
        drawn = np.random.default_rng(5).uniform(-1, 1, wide.n)
        starts = wide.variables(seed=5), wide.variables(wide.nodes(drawn))
        parts = [np.max(np.abs(start)) / np.max(np.abs(drawn)) for start in starts]
        for start, part, factor in zip(starts, parts, (0.5, 0.95), strict=True):
            np.testing.assert_allclose(start, part * drawn, atol=1e-12)
            assert wide.is_valid(start)
            assert not wide.is_valid(start / factor)
        assert parts[0] <= parts[1] < 1

    def test_a_point_where_an_element_is_too_small_is_not_valid(self) -> None:
        motion = Motion(2.0, min_area_fraction=0.2)
        problem = ContactProblem(rectangle(2, 2), Laplace(1.0), ("left",), motion=motion)
        outer, barrier, found = Outer.of(problem), Outer.of(problem, "energy + 0.1*quality"), []
        for height in np.linspace(0.5, 0.99, 30):  # of the middle node: areas beside it shrink in proportion
            nodes = problem.mesh.p.copy()
            nodes[1, np.argmin(np.abs(problem.mesh.p - 0.5).sum(axis=0))] = height
            q, ratio = outer.relocation.parts.mesh_map.q_of(nodes), area_ratio(problem, nodes)
            assert outer.is_valid(q) == (ratio >= 0.2 - 1e-9), (height, ratio)
            assert barrier.is_valid(q) == (ratio > 0)
            found.append(ratio)
        assert min(found) < 0.2 < max(found)


class TestAssessment:
    def test_zones_residuals_and_counts_of_a_record(self, outer: Outer) -> None:
        found = ended(outer, np.zeros(outer.n))
        rows = outer.discretisation.friction_rows
        sliding = np.count_nonzero(outer.contact.given.active.sliding[rows])
        assert found.final.sliding_nodes == sliding > 0
        assert found.final.sticking_nodes == rows.size - sliding
        assert found.own_residuals == found.final.residuals
        assert max(vars(found.own_residuals).values()) < 1e-9
        still = solved("fixed", "6.3", (4, 2)).record()
        assert still["cold_contact_solves"] == 1
        assert (still["status"], still["stationarity_residual"]) == ("converged", None)  # at rest
        assert still["contact_factorisations"] == outer.contact.given.iterations
        smooth = Outer.of(rm.EXAMPLES["6.2"]((4, 2)))
        assert ended(smooth, np.zeros(smooth.n)).final.sliding_nodes is None

    def test_own_residuals_are_those_of_the_formulation_s_state(self, outer: Outer) -> None:
        q = np.zeros(outer.n)
        state = outer.energy(q).equilibrium
        off = replace(state, u=1.01 * state.u, normal_force=-state.normal_force)
        found = ended(outer, q, own=off)
        assert found.own_residuals.equilibrium > 1e-3
        assert found.own_residuals.complementarity > 1e-3
        assert found.final.residuals.equilibrium < 1e-9
        assert found.final.energy == pytest.approx(state.energy, rel=1e-12)
        assert found.status is Status.INACCURATE
        assert ended(outer, q, Status.STALLED, own=off).status is Status.STALLED

    def test_rounding_is_relative_to_parts_of_the_energy_that_cancel(self) -> None:
        """Weight and lift: the strain energy is larger than their sum."""
        sides, law = (rm.Dirichlet("top", (0.0, 0.1)), rm.Dirichlet("bottom", (0.0, 0.0))), (0.3, 0.4)
        lifted = ContactProblem(rectangle(3, 2), PlaneStrain(*law, (0.0, -2.0)), sides, motion=Motion(0.05))
        outer = Outer.of(lifted)
        system, state = outer.contact.system(lifted.mesh.p), outer.contact.given
        strain = 0.5 * float(state.u @ (system.stiffness @ state.u))
        assert 0 < strain < 1
        assert abs(state.energy) < 0.2 * strain
        assert ended(outer, np.zeros(outer.n)).final.size == pytest.approx(strain, rel=1e-9)

    @pytest.mark.parametrize(
        ("label", "weak"),
        [*((label, (False, True)) for label in ("S", "B", "M", None)), ("S", (False, False))],
    )
    def test_a_label_proves_stationarity_where_some_node_is_weak(self, outer, label, weak, monkeypatch):
        """The mesh as given is not stationary by its residual."""
        monkeypatch.setattr(ReducedPoint, "weak", property(lambda point: np.array(weak)))
        found = ended(outer, np.zeros(outer.n), label=label)
        proved = label in ("S", "B") and any(weak)
        assert found.status is (Status.CONVERGED if proved else Status.NOT_STATIONARY)
        assert found.first_order.stationarity == (label or "")

    @pytest.mark.parametrize(("weight", "improved"), [(1e-9, True), (1e6, False)])
    def test_a_distortion_counts_in_what_has_improved(self, outer, weight, improved) -> None:
        """A mesh of lower energy is distorted: whether it is better depends on the weight."""
        lower, there = solved("joint", "6.3", (4, 2)), Outer.of(outer.problem, f"energy + {weight}*quality")
        found = ended(there, there.variables(lower.mesh.p))
        assert found.gain_audited > 0
        assert found.success == improved
