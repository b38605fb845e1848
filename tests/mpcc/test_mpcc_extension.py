"""An MPCC that is extended keeps its derivatives and its parts by name."""

from __future__ import annotations

import casadi as ca
import numpy as np

from rmesh_nlp.examples import EXAMPLES
from rmesh_nlp.mpcc import MPCC, solve
from rmesh_nlp.optimize.nlp import Derivatives
from support.formulations import joint, mpcc


def assert_same_derivatives(program: MPCC) -> None:
    """The program's own derivatives against CasADi's, at a random point."""
    rng = np.random.default_rng(0)
    column = ca.vertcat(program.g, program.G, program.H)
    x, p = rng.uniform(0.1, 0.2, program.n_x), np.zeros(program.p.shape[0])
    lam = rng.uniform(-1, 1, column.shape[0])
    values = ca.Function("values", [program.x, program.p], [program.f, column])
    own: Derivatives | None = program.derivatives
    assert own is not None
    assert own.hess_lag is not None
    g, jacobian = own.jac_g(x, p)
    f = own.grad_f(x, p)[0]
    np.testing.assert_allclose(g, values(x, p)[1], atol=1e-9)
    np.testing.assert_allclose(f, values(x, p)[0])
    step, d = 1e-6, rng.uniform(-1, 1, program.n_x)
    ahead, behind = own.jac_g(x + step * d, p)[0], own.jac_g(x - step * d, p)[0]
    scale = 1 + float(ca.norm_inf(g))
    np.testing.assert_allclose(jacobian @ d, (ahead - behind) / (2 * step), atol=1e-5 * scale)

    def slope(at: np.ndarray) -> ca.DM:
        return own.grad_f(at, p)[1] + own.jac_g(at, p)[1].T @ lam

    upper = own.hess_lag(x, p, 1.0, lam)
    hessian = upper + ca.triu(upper, False).T
    expected = (slope(x + step * d) - slope(x - step * d)) / (2 * step)
    np.testing.assert_allclose(hessian @ d, expected, atol=1e-4 * (1 + float(ca.norm_inf(expected))))


def test_rows_pairs_and_a_term_are_appended_to_the_bilevel_program() -> None:
    program = mpcc.build(EXAMPLES["6.3"]((4, 2)))
    assert list(program.parts) == [
        "q", "u", "normal_force", "slip", "friction_minus", "friction_plus"
    ]  # fmt: skip
    assert sum(part.shape[0] for part in program.parts.values()) == program.n_x
    y = ca.MX.sym("y")
    force, q = ca.sum1(program.parts["normal_force"]), program.parts["q"]
    longer = program.extended(x=y, f=1e-3 * y**2, g=ca.dot(q, q), ubg=1.0, G=y, H=1 + force, lbx=0.0)
    assert (longer.n_x, longer.n_g, longer.n_pairs) == (
        program.n_x + 1, program.n_g + 1, program.n_pairs + 1
    )  # fmt: skip
    assert longer.ubg[-1] == 1.0
    assert_same_derivatives(longer)


def test_an_extended_program_is_solved_with_its_new_row() -> None:
    x = ca.SX.sym("x", 2)
    program = MPCC(x, (x[0] - 1) ** 2 + (x[1] - 2) ** 2, None, x[0], x[1])
    assert solve(program, [0.1, 1.0]).x[1] > 1.9
    held = program.extended(g=x[1], ubg=0.5)
    result = solve(held, [0.1, 0.4])
    assert result.success
    assert result.x[1] <= 0.5 + 1e-8


def test_the_energy_program_has_parts_by_name() -> None:
    program = joint.build(EXAMPLES["6.3"]((4, 2)))
    assert list(program.parts) == ["q", "u", "slip"]
    assert sum(part.shape[0] for part in program.parts.values()) == program.n_x
