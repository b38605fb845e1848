"""Derivatives of assembled programs against those of CasADi from the same expressions."""

from typing import Any

import casadi as ca
import numpy as np


def assert_derivatives_are_casadis(
    program: Any,
    rows: Any = None,
    *,
    within: tuple[float, float] = (0.2, 1.5),
    seed: int = 0,
    tolerance: float = 1e-12,
) -> None:
    """Of an NLP or an MPCC at a random point: of f and its rows (by default g), of second order if known."""
    oracle = ca.Function("oracle", [program.x, program.p], [program.f, program.g if rows is None else rows])
    x, p = ca.MX.sym("x", oracle.numel_in(0)), ca.MX.sym("p", oracle.numel_in(1))
    f, g = oracle.call([x, p], True, False)
    lam = ca.MX.sym("lam", g.numel())
    hessian = ca.triu(ca.hessian(0.7 * f + ca.dot(lam, g), x)[0])
    parts = [f, ca.gradient(f, x), g, ca.jacobian(g, x), hessian]
    rng = np.random.default_rng(seed)
    at, parameters = (rng.uniform(*within, n) for n in (x.numel(), p.numel()))
    multipliers = rng.normal(size=lam.numel())
    expected = ca.Function("expected", [x, p, lam], parts)(at, parameters, multipliers)
    own = program.derivatives
    found = [*own.grad_f(at, parameters), *own.jac_g(at, parameters)]
    if own.hess_lag is not None:
        found.append(own.hess_lag(at, parameters, 0.7, multipliers))
    for one, other in zip(found, expected, strict=own.hess_lag is not None):
        known = ca.DM(other).full()
        size = max(1.0, np.abs(known).max(initial=0))
        np.testing.assert_allclose(ca.DM(one).full(), known, rtol=0, atol=tolerance * size)
