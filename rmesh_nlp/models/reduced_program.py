"""The outer problem as a nonlinear program in the moves alone, whose objective is a contact solve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.mapping.validity import is_upright
from rmesh_nlp.models.energy_program import Relocation
from rmesh_nlp.models.outer_function import Reduced
from rmesh_nlp.models.residual import OuterResidual
from rmesh_nlp.optimize.nlp import NLP, Derivatives


@dataclass(frozen=True)
class ReducedProgram:
    """The outer problem: its NLP in the moves q and the function behind its objective.

    A solver should end with a first-order ``residual`` of at most ``tolerance``. The objective of the NLP is
    in units of ``scale``. ``oracle`` must live as long as the NLP: CasADi does not own Python callbacks.
    ``warm`` says that the start is likely to be close to a minimiser.
    """

    nlp: NLP
    function: Reduced
    areas: ca.Function
    oracle: ca.Callback
    is_valid: Callable[[Array], bool]
    residual: OuterResidual
    scale: float
    tolerance: float
    out_of_time: Callable[[], bool] = lambda: False
    warm: bool = False

    @property
    def unit(self) -> float:
        """What the gradient is measured in."""
        return self.residual.unit


def reduced_nlp(
    rel: Relocation,
    function: Reduced,
    is_valid: Callable[[Array], bool],
    residual: OuterResidual,
    tolerance: float,
) -> ReducedProgram:
    """The NLP ``min F(q)`` over boxes and element areas; its objective is a contact solve."""
    q, p = rel.validity.q, ca.MX(0, 1)
    areas, bound = rel.validity.assembled, rel.validity.bound
    scale = scale_of(function, rel.n_q)
    oracle = _Oracle(function, rel, scale)
    value, gradient = oracle(q)
    nlp = NLP(
        x=q,
        p=p,
        f=value,
        g=areas.g,
        lbx=-rel.mesh_map.bound,
        ubx=rel.mesh_map.bound,
        lbg=bound,
        ubg=np.full(bound.size, np.inf),
        derivatives=Derivatives(
            grad_f=ca.Function("nlp_grad_f", [q, p], [value, gradient]),
            jac_g=areas.jac_g,
            hess_lag=None,
            kernels=areas.kernels,
        ),
    )
    return ReducedProgram(nlp, function, areas.jac_g, oracle, is_valid, residual, scale, tolerance)


class _Oracle(ca.Callback):
    """F(q) and its gradient as a CasADi Function, in units of ``|F(0)|``: a squared error may be small."""

    def __init__(self, function: Reduced, relocation: Relocation, scale: float) -> None:
        super().__init__()
        self._function, self._scale, self._n = function, scale, relocation.n_q
        self._relocation = relocation
        self.construct("reduced_energy", {})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 2

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._n)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._n if i else 1)

    def eval(self, arg: list[ca.DM]) -> list[Any]:
        q = arg[0].full().ravel()
        if not self._is_defined(q):
            return [np.nan, np.full(self._n, np.nan)]  # Ipopt then takes a shorter step
        point = self._function(q)
        return [point.value / self._scale, point.gradient / self._scale]

    def _is_defined(self, q: Array) -> bool:
        """Whether the objective is: the contact problem of a mesh with inverted elements has no meaning."""
        rel = self._relocation
        if rel.n_valid and not is_upright(rel.problem, rel.nodes(q)):
            return False
        return self._function.is_defined(q)


def scale_of(function: Reduced, n: int) -> float:
    """Size of the objective on the initial mesh, the unit in which it is minimised."""
    return abs(function(np.zeros(n)).value) or 1.0
