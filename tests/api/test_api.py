"""What ``import rmesh_nlp as rm`` offers, and solving, comparing, drawing and verifying through it."""

import ast
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import rmesh_nlp as rm
from formulations.joint import Joint
from formulations.multistart import MultiStart
from rmesh_nlp.fem.stress import stresses, von_mises
from rmesh_nlp.models import reduced_model
from rmesh_nlp.problem import NO_CONTACT
from rmesh_nlp.study.comparison import formulation_options

PROBLEM = rm.EXAMPLES["6.2"](n=(2, 2))


@pytest.fixture(scope="module")
def comparison() -> rm.Comparison:
    return rm.compare(rm.EXAMPLES["6.2"](n=(4, 2)), ["fixed", "joint"])


@pytest.mark.slow
def test_one_spelling_of_options_serves_names_tables_and_lists() -> None:
    """What Python takes by keyword, ``compare`` gives to those that take it, and a text may name too."""
    few = rm.Limits(iterations=1)
    alone = rm.solve(PROBLEM, "mpcc", t0=1e-3, twice=True, limits=few)
    both = rm.compare(PROBLEM, ["fixed", "mpcc"], t0=1e-3, twice=True, limits={"iterations": 1})
    asked = {"options": {"t0": 1e-3}, "twice": True}
    assert alone.settings == both["mpcc"].settings == asked
    assert alone.limits == both["mpcc"].limits == few
    assert formulation_options("mpcc:t0=1e-3:twice=true") == ("mpcc", {"t0": 1e-3, "twice": True})


def test_a_comparison_holds_solutions_records_and_tables(comparison: rm.Comparison) -> None:
    assert comparison.best is comparison["joint"]
    assert [record["formulation"] for record in comparison.records] == ["fixed", "joint"]
    summary = comparison.summary()
    assert summary.loc["joint", "gain_audited"] > summary.loc["fixed", "gain_audited"] == 0
    assert "joint" in repr(comparison)
    assert ", joint |" in comparison.markdown()


@pytest.mark.slow
def test_objects_of_one_class_are_told_apart_by_their_settings() -> None:
    kinds = ["fixed", "auto", Joint(), Joint(first_barrier=1e-2), MultiStart(Joint(), starts=1)]
    found = rm.compare(PROBLEM, kinds, limits=rm.Limits(iterations=1))
    names = ["fixed", "auto", "joint", "joint(first_barrier=0.01)", "multistart(joint, starts=1)"]
    assert list(found.summary().index) == list(found.solutions) == names
    assert found[names[3]].settings == {"first_barrier": 1e-2}
    assert all(name in found.markdown() for name in names)


def test_a_formulation_that_refuses_leaves_its_record() -> None:
    found = rm.compare(PROBLEM, ["joint"], objective="quality")
    assert found.records[0]["status"] == "refused"
    assert not found.solutions
    with pytest.raises(ValueError, match="no formulation succeeded"):
        found.best  # noqa: B018


def test_pictures_are_on_axes_of_ones_own_and_have_pressure_stress_and_both_meshes(comparison):
    for what in ("mesh", "displacement", "stress", "pressure"):
        axes = Figure().add_subplot()
        assert comparison["joint"].plot(what, axes) is axes
        assert axes.has_data()
        assert what in axes.get_title()
    solution = comparison["joint"]
    (line,) = solution.plot("pressure").lines
    where = solution.problem.contact_nodes
    assert np.ptp(np.diff(line.get_xdata())) > 0
    assert np.all(np.diff(line.get_xdata()) > 0)
    assert {*solution.final.pressure[where]} <= {*line.get_ydata()}
    (contact,) = solution.contact.values()
    assert np.max(line.get_ydata()) == contact["peak_pressure"]
    (painted,) = solution.plot("stress").collections
    stress = stresses(solution.problem, solution.mesh.p, solution.displacement)
    np.testing.assert_array_equal(painted.get_array(), von_mises(stress))
    for name, meshes in (("fixed", 1), ("joint", 2)):  # over the given one where it moved
        lines = comparison[name].plot("mesh").lines
        assert len(lines) == meshes
        corner = np.nanmax(lines[-1].get_xydata(), axis=0)
        np.testing.assert_array_equal(corner, comparison[name].mesh.p.max(axis=1))


def test_solutions_side_by_side_share_their_scale(comparison: rm.Comparison) -> None:
    axes = rm.plot(comparison["fixed"], comparison["joint"], what="displacement")
    assert len(axes) == 2
    assert all(isinstance(one, Axes) for one in axes)
    limits = [one.collections[0].get_clim() for one in axes]
    sizes = [np.linalg.norm(comparison[name].displacement, axis=0) for name in ("fixed", "joint")]
    assert limits == [(np.min(sizes), np.max(sizes))] * 2


@pytest.mark.slow
def test_a_gradient_passes_its_taylor_test_and_a_wrong_one_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    test = rm.verify_gradient(rm.EXAMPLES["6.3"](n=(4, 2)))
    assert test
    assert test.order == pytest.approx(2, abs=0.1)
    np.testing.assert_allclose(test.steps, 1e-2 * 0.5 ** np.arange(5))
    assert rm.verify_gradient(rm.EXAMPLES["6.3"](n=(4, 2)), seed=1).value != test.value
    right = reduced_model.ReducedEnergy.__call__

    def wrong(self: reduced_model.ReducedEnergy, q: np.ndarray) -> reduced_model.ReducedPoint:
        point = right(self, q)
        return replace(point, gradient=1.001 * point.gradient)

    monkeypatch.setattr(reduced_model.ReducedEnergy, "__call__", wrong)
    test = rm.verify_gradient(rm.EXAMPLES["6.1"](n=4))
    assert not test
    assert "WRONG" in dict(test.summary())["gradient"]


FREE = replace(PROBLEM, obstacle=NO_CONTACT)


@pytest.mark.parametrize(
    ("misuse", "message"),
    [
        (lambda: rm.solve("my.toml"), "problem must be ContactProblem, which read_problem makes of a file"),
        (lambda: rm.compare(None), "problem must be ContactProblem, got None"),
        (lambda: rm.certify(PROBLEM), "solution must be Solution, got "),
        (lambda: rm.write_solution({}, "solution.vtu"), "solution must be Solution, got {}"),
        (lambda: rm.solve_mpcc({"x": 1}, [0]), "mpcc must be MPCC, got {'x': 1}"),
        (lambda: rm.solve(PROBLEM, objective=5), "objective must be a text or an Objective, got 5"),
        (lambda: rm.solve(PROBLEM, Joint(), tol=1e-8), r"fields of the formulation: Joint\(tol=...\)"),
        (lambda: rm.solve(PROBLEM, 3), "formulation must be a name or an object .*, got 3"),
        (lambda: rm.solve(PROBLEM, Joint), "formulation must be .*, got <class .*Joint"),
        (lambda: rm.compare(PROBLEM, [Joint]), "formulation must be .*, got <class .*Joint"),
        (lambda: rm.EXAMPLES[6.1], "the name of an example must be a text, got 6.1"),
        (lambda: rm.compare(PROBLEM, "joint"), "a list of names or formulations, got 'joint'"),
        (lambda: rm.compare(PROBLEM, ["joint", Joint()]), "named twice"),
        (lambda: rm.compare(PROBLEM, [Joint()], tol=1e-3), r"tol = 0\.001 is not an option of joint"),
        (lambda: rm.solve(FREE, "fixed").plot("strain"), "strain"),
        (lambda: rm.solve(FREE, "fixed").plot("pressure"), "no contact"),
    ],
)
def test_misuse_is_bad_input(misuse, message):
    with pytest.raises(ValueError, match=message):
        misuse()


STUB = Path(rm.__file__).with_suffix(".pyi")


def test_every_public_name_is_there() -> None:
    for name in rm.__all__:
        assert getattr(rm, name) is not None
        assert name in dir(rm)
    assert {"importlib", "Any"}.isdisjoint(dir(rm))
    assert rm.mpcc.solve is rm.solve_mpcc  # the package of the solver keeps its name
    assert {"fixed", "joint", "mpcc", "nested"} <= set(rm.formulations())
    with pytest.raises(AttributeError, match="has no attribute 'slove'"):
        rm.slove  # noqa: B018


def test_type_checkers_see_what_python_sees() -> None:
    seen = {}
    for node in ast.parse(STUB.read_text()).body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                if alias.asname is not None:  # a stub re-exports only what it names again
                    module = __import__(node.module or "", fromlist=[alias.name])
                    seen[alias.asname] = getattr(module, alias.name)
    assert {*seen, "__version__", "objective", "read_problem", "solve_mpcc"} == set(rm.__all__)
    for name, value in seen.items():
        assert getattr(rm, name) is value, name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        ("import rmesh_nlp; dir(rmesh_nlp)", {"casadi", "numpy", "rich"}),
        (
            "from rmesh_nlp.cli import app, entry; app.run(['solve', '--help'])",
            {"casadi", "matplotlib", "pandas", "skfem", "scipy", "meshio", "numpy"},
        ),
        ("import rmesh_nlp.mpcc", {"skfem", "meshio", "pandas", "matplotlib", "jinja2", "pydantic", "typer"}),
    ],
)
def test_nothing_heavy_is_loaded_before_it_is_used(code: str, heavy: set[str]) -> None:
    code += f"; import sys; print({heavy} & {{*sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "set()"
