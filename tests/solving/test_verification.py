"""Taylor tests find wrong gradients, and Theorem 4.1 holds term by term."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rmesh_nlp as rm
from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.meshes.shapes import rectangle
from rmesh_nlp.problem import ContactProblem, Laplace, Motion
from rmesh_nlp.solving import solution
from rmesh_nlp.solving.verification import TaylorTest, error_terms, verify_gradient
from support.orders import ORDERS
from support.sliding import sliding_block
from support.solved import solved


def total(terms: dict[str, float]) -> float:
    return terms["I1"] + terms["I2"] + terms["I3"]


def taylor_test(orders: list[float]) -> TaylorTest:
    n = len(orders) + 1
    return TaylorTest("mine", 1.0, 2.0, np.ones(n), np.ones(n), np.array(orders))


def test_the_last_known_order_of_a_taylor_test_decides() -> None:
    for orders, order in (([1.0, 2.0, np.nan], 2.0), ([2.0, 1.0], 1.0), ([np.nan, np.nan], np.inf)):
        assert taylor_test(orders).order == order
    assert [bool(taylor_test(orders)) for orders in ([2.0, 1.89], [1.0, 1.9])] == [False, True]
    values = [value.strip() for _, value in taylor_test([2.0, 1.5]).summary()]
    assert values == ["2", "1.00e+00", "1.00e+00 order 2.00", "1.00e+00 order 1.50", "WRONG: order 1.50"]
    assert taylor_test([1.0, 2.0]).summary()[-1][1] == "right: order 2.00"


def test_rounding_says_nothing_of_a_gradient() -> None:
    """The position of a node is linear: its remainders are rounding, and no order is known."""
    problem = ContactProblem(rectangle(3, 3), Laplace(1.0), ("left",), motion=Motion(0.05))
    node = int(np.argmin(np.abs(problem.mesh.p - 1 / 3).sum(axis=0)))
    test = verify_gradient(problem, rm.quantities.nodal([node], lambda X, u: X[0, 0] + 3.0))
    assert np.all(np.isnan(test.orders))
    assert test.order == np.inf
    assert test


def test_nothing_that_moves_is_refused() -> None:
    problem = ContactProblem(rectangle(1, 1), Laplace(1.0), ("left",), motion=Motion(0.05))
    with pytest.raises(ValueError, match="may move: there is no gradient"):
        verify_gradient(problem)


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_with_friction_the_third_term_closes_the_sum(order: int) -> None:
    found = []
    for n in (4, 8):
        problem = replace(sliding_block(n), order=order)
        terms = error_terms(problem, problem.mesh.p)
        assert min(terms["I1"], terms["I3"]) > 0  # on these grids nodes slide where the exact solution sticks
        assert terms["I2"] >= -1e-12
        # loads and displacement are polynomials on the elements, so rules are exact and nothing is left over
        assert total(terms) == pytest.approx(terms["energy_above_exact"], rel=1e-9)
        assert total(terms) - terms["I3"] != pytest.approx(terms["energy_above_exact"], rel=1e-6)
        found.append(terms)
    assert total(found[1]) < 0.5 * total(found[0])


def test_the_terms_sum_to_the_energy_above_the_exact_one_whatever_the_rule() -> None:
    one, two = (EXAMPLES["6.1"](4).with_rule(rule) for rule in (1, 8))
    terms = error_terms(one, one.mesh.p)
    assert terms == error_terms(two, two.mesh.p)
    assert terms["I3"] == 0
    assert min(terms["I1"], terms["I2"]) > 0
    assert total(terms) == pytest.approx(terms["energy_above_exact"], rel=1e-5)  # but for the load by a rule


def test_a_record_has_the_terms_and_their_time_and_a_broken_mesh_has_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = solved("fixed", "6.1", 4)
    record, terms = found.record(), error_terms(found.problem, found.mesh.p)
    assert record.items() >= terms.items()
    assert found.record()["audit_time_s"] == record["audit_time_s"] > found.audit_time_s
    assert record["wall_time_s"] - found.wall_time_s == pytest.approx(
        record["audit_time_s"] - found.audit_time_s
    )
    monkeypatch.setattr(solution, "error_terms", lambda *_: pytest.fail("it was evaluated"))
    inverted = replace(found.assessment.final, min_area_ratio=0.0)
    broken = replace(found, assessment=replace(found.assessment, final=inverted))
    assert broken.record()["status"] == "invalid_mesh"


def test_without_an_exact_solution_there_are_no_terms() -> None:
    problem = EXAMPLES["6.2"]((6, 4))
    assert error_terms(problem, problem.mesh.p) == {}
