"""Second derivatives of the energy program at a contact solution, block by block."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse as sp

from rmesh_nlp.contact.system import Equilibrium
from rmesh_nlp.evaluation import Array, Block, Evaluator, Symmetric, numbered
from rmesh_nlp.models.energy_program import Relocation, with_lower_rule


@dataclass(frozen=True)
class Blocks:
    """Blocks of the Hessian of ``J - lambda . gap - tau . u_t`` in moves q, displacement u and slip s.

    Attributes
    ----------
    qq, qu, qs : sparse arrays
    gap : (contact nodes, n_q) sparse array
        Derivative of the gaps by the moves.
    slip : (n_s, n_q) sparse array
        Derivative of the slips u_t by the moves; zero where no foundation is curved.
    """

    qq: sp.csc_array
    qu: sp.csc_array
    qs: sp.csc_array
    gap: sp.csc_array
    slip: sp.csc_array


class SecondDerivatives:
    """Evaluates the blocks; where they are in the whole is found once.

    Parameters
    ----------
    relocation : Relocation
    rule : int, optional
        Degree of the quadrature rule of the loads in the Hessian, if that of the problem is higher.
    """

    def __init__(self, relocation: Relocation, rule: int | None = None) -> None:
        self._relocation = rel = relocation
        self._modelled = rel if rule is None else with_lower_rule(rel, rule)
        hessian, jacobian = self._modelled.assembled.hess_lag, rel.assembled.jac_g
        self._hessian, self._jacobian = Evaluator(hessian), Evaluator(jacobian)
        q, u, s = (slice(a, b) for a, b in pairwise(np.cumsum([0, rel.n_q, rel.n_u, rel.n_s])))
        upper = numbered(hessian.sparsity_out(0))
        self._qq = Symmetric(upper, rel.n_q)
        self._qu, self._qs = Block(upper, q, u), Block(upper, q, s)
        first = numbered(jacobian.sparsity_out(1))
        self._gap, self._slip = Block(first, rel.gap_rows, q), Block(first, rel.slip_rows, q)

    def __call__(self, x: Array, equilibrium: Equilibrium) -> Blocks:
        """At unknowns ``x = (q, u, s)`` of a contact solution."""
        rel = self._relocation
        rows = np.zeros(rel.n_rows)
        rows[rel.gap_rows] = -equilibrium.normal_force
        if rel.n_s:
            rows[rel.slip_rows] = -equilibrium.tangential_force[rel.friction_rows]
        (values,) = self._hessian(x, [], 1.0, rows)
        _, first = self._jacobian(x, [])
        return Blocks(
            self._qq(values), self._qu(values), self._qs(values), self._gap(first), self._slip(first)
        )
