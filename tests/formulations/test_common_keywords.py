"""What all formulations share: keywords, starts, limits, Ctrl-C, settings."""

import re
from dataclasses import fields, replace

import numpy as np
import pytest

import rmesh_nlp as rm
from formulations.auto import Auto
from formulations.cascade import Cascade, Descent
from formulations.fixed import Fixed
from formulations.joint import Joint
from formulations.mpcc import AllAtOnce
from formulations.multistart import MultiStart
from formulations.nested import Nested
from formulations.outer_solvers import NestedSettings
from formulations.remeshed import Remeshed
from formulations.schedule import Schedule
from rmesh_nlp.mpcc import Options
from rmesh_nlp.optimize.newton_step import NewtonSettings
from rmesh_nlp.solving.formulation import KEYWORDS, options
from rmesh_nlp.solving.parts import Step
from support.formulations import auto, fixed, joint, mpcc, nested
from support.solved import example, solved

FORMULATIONS = [fixed, nested, joint, mpcc]
SMALL = example("6.2", (4, 2))
UNLIMITED = replace(SMALL, motion=replace(SMALL.motion, delta=None))


@pytest.mark.parametrize("formulation", [*FORMULATIONS, auto])
def test_every_formulation_has_the_common_keywords(formulation):
    taken = {"audit", "objective"} if formulation is fixed else {*KEYWORDS}
    assert options(formulation.name) & {*KEYWORDS, "sede"} == taken


WITH_STEPS = pytest.mark.parametrize(
    ("formulation", "problem"),
    [(nested, SMALL), (joint, SMALL), (mpcc, SMALL), pytest.param(auto, UNLIMITED, marks=pytest.mark.slow)],
    ids=["nested", "joint", "mpcc", "cascade"],
)


@WITH_STEPS
def test_a_limit_of_iterations_holds_and_is_said(formulation, problem):
    steps: list[Step] = []
    solution = formulation.solve(problem, limits={"iterations": 2}, tolerance=1e-5, on_step=steps.append)
    assert solution.status is rm.Status.ITERATION_LIMIT
    assert solution.trace.iterations == steps[-1].iteration == 2
    assert solution.valid
    assert solution.energy < solution.energy_initial
    record = solution.record()
    assert (record["tolerance"], record["settings"]) == (1e-5, {})
    assert record["limits"] == {"iterations": 2}


@WITH_STEPS
def test_a_time_limit_and_ctrl_c_keep_the_best_valid_mesh(formulation, problem):
    late = formulation.solve(problem, limits={"seconds": 1e-6})
    assert (late.status, late.valid, late.success) == (rm.Status.TIME_LIMIT, True, True)
    assert late.energy <= late.energy_initial + 1e-9
    assert late.record().get("error_reduction") is None
    seen: list[Step] = []

    def interrupt(step: Step) -> None:
        seen.append(step)
        if len(seen) == 3:
            raise KeyboardInterrupt

    stopped = formulation.solve(problem, on_step=interrupt)
    assert (stopped.status, stopped.valid) == (rm.Status.INTERRUPTED, True)
    assert len(seen) >= 3


@WITH_STEPS
def test_an_error_of_on_step_reaches_the_caller(formulation, problem):
    """CasADi takes one in its iteration callback for a failed evaluation."""

    class OwnError(Exception):
        pass

    def fail(step: Step) -> None:
        raise OwnError(step.iteration)

    with pytest.raises(OwnError):
        formulation.solve(problem, on_step=fail)


@pytest.mark.parametrize(
    ("keyword", "bad", "message"),
    [
        *(("tolerance", bad, f"tolerance must be .*, got {bad!r}") for bad in (-1, float("nan"), "1")),
        ("limits", {"minutes": 1}, "unknown setting 'minutes'"),
        ("limits", 60, "limits must be Limits or a mapping of its fields, got 60"),
        ("seed", "a", "seed must be a whole number of at least 0, got 'a'"),
        ("starts", 0, "starts must be a whole number of at least 1, got 0"),
        ("tolerance", 0, "tolerance must be positive and finite, got 0"),
        ("limits", {"seconds": 0}, "seconds must be positive and finite, got 0"),
        ("limits", {"iterations": 1.5}, r"iterations must be a whole number of at least 0, got 1\.5"),
        ("start", "jiont", "unknown start 'jiont': did you mean joint"),
        ("start", "auto", "unknown start 'auto': choose from given, adaptive, cascade, fixed, joint"),
        ("start", np.zeros((2, 3)), "the start has 3 nodes, the problem 15"),
        ("tolerance", 2, "tolerance must be below 1, got 2"),
        ("start", np.add(SMALL.mesh.p, [[0.0], [1.0]]), "start: node 0 is 1 away from where its move limits"),
        ("start", np.zeros(3), r"start must hold positions \(2, nodes\), got an array of shape \(3,\)"),
        ("start", np.full((2, 15), np.nan), "start: node 0 has no finite position"),
        ("start", SMALL, r"start must be a name, positions \(2, .* got Contact problem '6\.2'"),
        ("on_step", 3, "on_step must be a function of a step, got 3"),
        ("speed", 3, "speed = 3 is not an option of joint, did you mean 'seed'"),
        ("speed", False, "speed = False is not an option of joint"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(keyword, bad, message):
    with pytest.raises(rm.BadInputError, match=message):
        joint.solve(SMALL, **{keyword: bad})


@pytest.mark.slow
@pytest.mark.parametrize("formulation", [nested, joint, mpcc])
def test_starts_are_positions_names_and_solutions(formulation):
    end = solved(formulation.name, "6.2", (4, 2))
    starts = [(np.asarray(end.mesh.p), "positions"), (end, f"solution of {end.formulation}")]
    for start, name in (*starts, ("fixed", "fixed"), ("given", "given")):
        solution = formulation.solve(SMALL, start=start)
        assert (solution.start, solution.success) == (name, True)
    assert formulation.solve(SMALL, start=end).trace.iterations <= end.trace.iterations + 20


@pytest.mark.parametrize(
    ("formulation", "settings"),
    [
        (joint, {"tol": 1e-3}),
        pytest.param(nested, {"newton": {"first_radius": 1e-3, "max_products": 10}}, marks=pytest.mark.slow),
        pytest.param(mpcc, {"options": {"t0": 1e-3}}, marks=pytest.mark.slow),
    ],
)
def test_settings_that_differ_from_the_defaults_are_in_the_record_and_change_the_path(formulation, settings):
    solution = formulation.solve(example("6.3", (4, 2)), **settings)
    assert solution.record()["settings"] == settings
    usual = solved(formulation.name, "6.3", (4, 2))
    assert [step.objective for step in solution.history] != [step.objective for step in usual.history]


def test_nothing_to_move_is_no_crash() -> None:
    still = replace(SMALL, motion=rm.Motion(0.1, pinned=tuple(range(SMALL.mesh.p.shape[1]))))
    solution = nested.solve(still)
    assert solution.status is rm.Status.CONVERGED
    assert solution.energy == solution.energy_initial


@pytest.mark.slow
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_one_contact_node_and_no_load_are_solved(formulation):
    assert np.isfinite(formulation.solve(rm.EXAMPLES["6.1"](2)).energy)
    unloaded = formulation.solve(replace(SMALL, tractions=()))
    assert (unloaded.status, unloaded.success) == (rm.Status.CONVERGED, True)


WRAPPERS = (MultiStart, Remeshed, Schedule)
FORMS = (AllAtOnce, Auto, Cascade, Descent, Fixed, Joint, Nested, *WRAPPERS)
KINDS = (NewtonSettings, *FORMS, NestedSettings, Options, rm.Limits)


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_is_documented(kind):
    documented = " ".join(re.findall(r"^ *([\w, ]+) : ", kind.__doc__ or "", re.M)).replace(",", " ").split()
    known = {field.name for field in fields(kind)}
    assert documented == [name for name in vars(kind).get("__annotations__", {}) if name in known]


@pytest.mark.parametrize("kind", KINDS)
def test_every_number_is_checked(kind):
    usual = kind(Fixed()) if kind in WRAPPERS else kind()
    for one in fields(kind):
        default = getattr(usual, one.name)
        if isinstance(default, (int, float)) and not isinstance(default, bool):
            for bad in (-1.0, float("nan"), "1", True):
                with pytest.raises(rm.BadInputError, match=one.name):
                    usual.having({one.name: bad})


def test_what_is_no_field_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(rm.BadInputError, match=r"unknown setting 'forcin': did you mean forcing\?"):
        NestedSettings.of({"newton": {"forcin": 0.5}})


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        (Joint, {"ipopt": 3}),
        (Options, {"warm_duals": "yes"}),
        *((kind, {"distortion": bad}) for kind in (Cascade, Auto) for bad in (1, "oval")),
        *((Cascade, {"schedule": bad}) for bad in ((0.0,), (1.0, -1.0), "x")),
    ],
)
def test_what_is_no_number_is_checked_too(kind, given):
    with pytest.raises(rm.BadInputError, match=next(iter(given))):
        kind.of(given)


def test_a_change_keeps_what_was_chosen_before() -> None:
    first = NestedSettings.of({"iterations": 7, "newton": {"forcing": 0.5}})
    both = first.having({"newton": {"max_products": 5}})
    assert both.changed() == {"iterations": 7, "newton": {"max_products": 5, "forcing": 0.5}}


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"max_iterr": 3}, "has no 'max_iterr', did you mean 'max_iter'?"),
        ({"tol": 1e-8, "max_iter": "three"}, "refuses max_iter = 'three' here"),
        ({"mu_strategy": "adaptiv"}, "refuses mu_strategy = 'adaptiv' here"),
        ({"linear_solver": "pardiso"}, "refuses linear_solver = 'pardiso' here"),
    ],
)
def test_a_wrong_option_of_ipopt_is_named(option, message, capfd):
    with pytest.raises(rm.BadInputError, match="ipopt must be options of Ipopt, which") as caught:
        Joint(ipopt=option)
    assert str(caught.value).endswith(message)
    assert capfd.readouterr().out == ""
