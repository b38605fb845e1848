"""Pyomo models with ``pyomo.mpec``, read as they are and solved by the registered solver."""

import numpy as np
import pytest

from rmesh_nlp.mpcc import read, solve

pe = mpec = common = None
"""Modules of Pyomo, which takes a second to load."""


@pytest.fixture(scope="module", autouse=True)
def registered():
    """The solver that the import registers."""
    global pe, mpec, common
    pe, mpec, common = (pytest.importorskip(f"pyomo.{name}") for name in ("environ", "mpec", "common"))
    import rmesh_nlp.mpcc.pyomo_solver  # noqa: F401

    return pe.SolverFactory("rmesh-mpcc")


def model():
    """Minimum of (x - 2)^2 + (y - 1)^2 + z on 0 <= x _|_ y >= 0, x + z >= 3, z >= 3/4."""
    m = pe.ConcreteModel(name="pair")
    m.x, m.y, m.z = pe.Var(initialize=1.0), pe.Var(initialize=0.1), pe.Var(bounds=(0.75, None))
    m.cost = pe.Objective(expr=(m.x - 2) ** 2 + (m.y - 1) ** 2 + m.z)
    m.least = pe.Constraint(expr=m.x + m.z >= 3)
    m.pair = mpec.Complementarity(expr=mpec.complements(m.x >= 0, m.y >= 0))
    m.dual = pe.Suffix(direction=pe.Suffix.IMPORT)
    m.ipopt_zL_out = pe.Suffix(direction=pe.Suffix.IMPORT)
    return m


def test_values_and_duals_of_a_model(registered, capfd):
    """At y = 0, z = 3/4 and x = 9/4 a larger right-hand side costs 2 (x - 2), z's bound the rest."""
    m = model()
    found = registered.solve(m, tee=True, options={"relaxation": "scholtes", "ipopt.tol": 1e-9})
    assert (found.solver.termination_condition, found.solver.status) == ("optimal", "ok")
    assert "stationarity S" in found.solver.message
    assert "relaxed" in capfd.readouterr().out
    assert [m.x(), m.y(), m.z()] == pytest.approx([2.25, 0.0, 0.75], abs=1e-6)
    assert m.dual[m.least] == pytest.approx(0.5, abs=1e-5)
    assert m.ipopt_zL_out[m.z] == pytest.approx(0.5, abs=1e-5)
    problem = read(m)
    assert problem.name == "pair"
    assert solve(problem.mpcc, problem.x0).f == pytest.approx(m.cost(), abs=1e-7)
    assert (m.pair.ctype, m.pair.active) == (mpec.Complementarity, True)  # as it was


@pytest.mark.slow
def test_a_model_is_solved_again_from_its_duals(registered):
    """Suffixes of a former solve take the place of the relaxations."""
    m = model()
    m.dual.direction = pe.Suffix.IMPORT_EXPORT
    m.ipopt_zL_in = pe.Suffix(direction=pe.Suffix.EXPORT)
    registered.solve(m)
    m.ipopt_zL_in.update(m.ipopt_zL_out)
    problem = read(m)
    again = solve(problem.mpcc, problem.x0, start=problem.start)
    assert again.success
    assert [stage.phase for stage in again.history] == ["newton"]
    assert np.any(problem.start.lam_g)
    assert solve(problem.mpcc, problem.x0).counts["nlp_solves"] > 1
    m.z.setlb(0.8)
    found = registered.solve(m)
    assert "in 1 NLPs" in found.solver.message
    assert [m.x(), m.z()] == pytest.approx([2.2, 0.8], abs=1e-6)


def mixed():
    """0 <= z <= 2 _|_ z - x + 1 in place of the row, and a condition on a variable that is nowhere else.

    Between the bounds z = x - 1, least (x - 2)^2 + 1 + x - 1 at x = 1.5.
    """
    m = model()
    m.del_component("least")
    m.z.setlb(-5)
    m.mixed = mpec.Complementarity(expr=mpec.complements(pe.inequality(0, m.z, 2), m.z - m.x + 1))
    m.elsewhere = pe.Var(initialize=0.5)
    m.other = mpec.Complementarity(expr=mpec.complements(m.z + 1 >= 0, m.elsewhere >= 0))
    return m


@pytest.mark.slow
def test_mixed_conditions_are_solved_and_the_model_is_left_as_it_was(registered, caplog):
    """Solved again, stopped by the time limit, and refused for bounds that it names."""
    m = mixed()
    for limit, condition in ((60, "optimal"), (60, "optimal"), (1e-6, "maxIterations")):
        assert not caplog.records
        found = registered.solve(m, timelimit=limit)
        assert found.solver.termination_condition == condition
        assert (m.mixed.ctype, m.z.bounds) == (mpec.Complementarity, (-5, None))
        if condition == "optimal":
            assert [m.x(), m.y(), m.z(), m.elsewhere()] == pytest.approx([1.5, 0.0, 0.5, 0.0], abs=1e-6)
    m.z.setlb(3)
    m.z.setub(1)
    with pytest.raises(common.errors.ApplicationError):
        registered.solve(m, symbolic_solver_labels=True)
    assert "(z) = 3.0" in caplog.text
    assert m.mixed.ctype is mpec.Complementarity


@pytest.mark.parametrize(
    ("low", "cost", "form", "expected"),
    [
        # bounds x, y >= 1 hold, and complement nothing
        (1, (1, 1), lambda m: (m.x >= 0, m.y >= 0), None),
        (1, (1, 1), lambda m: (m.x >= 1, m.y >= 0), (1, 1)),
        (-1, (1, -1), lambda m: (pe.inequality(-2, m.x, 3), m.y - 1), (-1, 1)),
        # y is in no row and, with no cost, not in the objective
        (0, (2, 0), lambda m: (m.x >= 1, m.y >= 0), (1, None)),
        (0, (1, 1), lambda m: (m.x >= m.bound, m.y >= 1), (2, 1)),
        (0, (1, 1), lambda m: (m.x <= -1, m.y >= 1), None),
    ],
)
def test_bounds_of_variables_are_no_bounds_of_conditions(registered, low, cost, form, expected):
    """A condition is complementary at its own bounds, and the box holds beside it."""
    m = pe.ConcreteModel()
    m.x, m.y = (pe.Var(bounds=(low, 4), initialize=1) for _ in range(2))
    m.bound = pe.Param(initialize=2, mutable=True)
    m.cost = pe.Objective(expr=cost[0] * m.x + cost[1] * m.y)
    m.pair = mpec.Complementarity(expr=mpec.complements(*form(m)))
    found = registered.solve(m, load_solutions=False)
    m.solutions.load_from(found)
    if expected is None:
        assert found.solver.termination_condition == "infeasible"
    else:
        assert found.solver.termination_condition == "optimal"
        for variable, value in zip((m.x, m.y), expected, strict=True):
            assert value is None or variable() == pytest.approx(value, abs=1e-6)


def test_conditions_without_two_constant_bounds_are_refused(registered):
    """The message names the condition; the model stays as it was."""
    m = pe.ConcreteModel()
    m.x, m.y = pe.Var(), pe.Var()
    m.cost = pe.Objective(expr=m.x + m.y)
    for form in ((m.x == 1, m.y >= 0), (m.x, m.y), (pe.inequality(m.y, m.x, 2), m.y)):
        m.pair = mpec.Complementarity(expr=mpec.complements(*form))
        with pytest.raises(ValueError, match="condition pair"):
            registered.solve(m)
        assert m.pair.ctype is mpec.Complementarity
        m.del_component("pair")
