"""The quadrature rule that suits a load: exact for polynomials, of high degree for anything else.

An optimiser moves nodes to where a rule of low degree is wrong. So a problem that names no rule gets one
that no motion of the nodes can deceive, or hardly any.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from rmesh_nlp.problem.coefficients import Coefficient, PiecewiseLinear, at

MIDPOINT = "midpoint"
"""The three edge midpoints, exact to degree 2."""

HIGH = 8
"""Degree for loads that are no polynomials. Of random problems with loads such as 4 sin(3 x) + x y none of
those solved with degree 6 had a gain that the audit did not confirm to 10 %; 8 is for faster
oscillations."""

HIGHEST_POLYNOMIAL = 7
"""A polynomial of higher degree counts as none: a rule of degree ``HIGH`` is exact up to this one."""

LARGEST_EXPRESSION = 5_000
"""Operations in a derivative beyond which it is not looked at further."""


def suitable_rule(loads: Sequence[Coefficient], tractions: Sequence[Coefficient]) -> str | int:
    """The cheapest rule that is exact for these loads times linear functions, or ``HIGH``.

    Tractions are integrated with degree 4 at least, whatever the rule.
    """
    body = [polynomial_degree(load) for load in loads]
    edge = [polynomial_degree(traction) for traction in tractions]
    if any(degree is None for degree in (*body, *edge)):
        return HIGH
    needed = max((degree + 1 for degree in body if degree is not None), default=0)
    on_edges = max((degree + 1 for degree in edge if degree is not None), default=0)
    needed = max(needed, on_edges if on_edges > 4 else 0)
    return MIDPOINT if needed <= 2 else needed


def polynomial_degree(coefficient: Coefficient) -> int | None:
    """Degree in x and y together; None if it is no polynomial up to ``HIGHEST_POLYNOMIAL``."""
    if not callable(coefficient):
        return 0
    if isinstance(coefficient, PiecewiseLinear):
        return 1 if not coefficient.kinks else None
    point = ca.SX.sym("point", 2)
    try:
        derivatives = ca.SX(at(coefficient, point[0], point[1]))
    except (NotImplementedError, RuntimeError, TypeError, ValueError):
        return None  # a function of MX alone, or one that the assembly refuses with a reason
    for degree in range(HIGHEST_POLYNOMIAL + 1):
        if ca.Function("count", [point], [derivatives]).n_nodes() > LARGEST_EXPRESSION:
            return None
        highest = derivatives
        derivatives = ca.sparsify(ca.simplify(ca.vec(ca.jacobian(derivatives, point))))
        derivatives = ca.vertcat(*{hash(e): e for e in ca.vertsplit(derivatives) if e.nnz()}.values())
        if derivatives.shape[0] == 0:
            # that of a branch, such as |x|, depends on the point by its condition
            return None if ca.depends_on(highest, point) else degree
    return None
