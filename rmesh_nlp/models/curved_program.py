"""The reduced objective's Hessian as a dense matrix, for solvers that factorise.

One column of the Hessian is one product with it, a back-substitution with the stiffness of the contact solve:
up to a few thousand moves all columns together cost less than what solvers without them spend in
more iterations. The program is smooth but for jumps of the second derivative where contact changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array
from rmesh_nlp.models.curvature import Curvature
from rmesh_nlp.models.objective_curvature import ObjectiveCurvature
from rmesh_nlp.models.reduced import ReducedEnergy
from rmesh_nlp.models.reduced_certificate import ReducedCertificate
from rmesh_nlp.models.reduced_program import ReducedProgram
from rmesh_nlp.models.secant_curvature import SecantCurvature

COLUMNS = 256
"""Columns of the Hessian that are computed at a time; it bounds the memory for changes of displacement."""


def curvature_of(program: ReducedProgram) -> Curvature | ObjectiveCurvature | SecantCurvature:
    """Second derivatives of the outer objective of a program."""
    function = program.function
    if isinstance(function, ReducedEnergy):
        return Curvature(function)
    if isinstance(function, ReducedCertificate):
        return SecantCurvature(function)
    return ObjectiveCurvature(function.energy, function.objective)


def with_hessian(program: ReducedProgram) -> ReducedProgram:
    """The same program, with the second derivatives of its Lagrangian."""
    nlp = program.nlp
    assert nlp.derivatives is not None
    second = _SecondOracle(program)
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", nlp.n_g)
    hess_lag = ca.Function("nlp_hess_l", [nlp.x, nlp.p, lam_f, lam_g], [second(nlp.x, lam_f, lam_g)])
    derivatives = replace(nlp.derivatives, hess_lag=hess_lag, kernels=(*nlp.derivatives.kernels, second))
    return replace(program, nlp=replace(nlp, derivatives=derivatives))


class _SecondOracle(ca.Callback):
    """Upper triangle of the Hessian of ``lam_f f + lam_g^T g``, f in the units of the program."""

    def __init__(self, program: ReducedProgram) -> None:
        super().__init__()
        self._n, self._rows = program.nlp.n_x, program.nlp.n_g
        self._function, self._scale = program.function, program.scale
        self._curvature = curvature_of(program)
        function = program.function
        energy = function if isinstance(function, ReducedEnergy) else function.energy
        self._validity = energy.validity if self._rows else None
        self._upper = ca.Sparsity.upper(self._n)
        rows, columns = (np.array(index, dtype=np.int64) for index in self._upper.get_triplet())
        self._rows_of, self._columns_of = rows, columns
        self.construct("reduced_hessian", {})

    def get_n_in(self) -> int:
        return 3

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense((self._n, 1, self._rows)[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._upper

    def eval(self, arg: list[ca.DM]) -> list[ca.DM]:
        q, lam_f, lam_g = arg[0].full().ravel(), float(arg[1]), arg[2].full().ravel()
        hessian = dense(self._curvature.at(self._function(q)), self._n) * (lam_f / self._scale)
        if self._validity is not None:
            hessian += self._validity.hessian(q, lam_g)
        return [ca.DM(self._upper, hessian[self._rows_of, self._columns_of].tolist())]


def dense(model: Callable[[Array], Array], n: int) -> Array:
    """The matrix of a model, symmetric up to rounding and made so."""
    matrix = np.empty((n, n))
    for first in range(0, n, COLUMNS):
        unit = np.zeros((n, min(COLUMNS, n - first)))
        unit[first + np.arange(unit.shape[1]), np.arange(unit.shape[1])] = 1.0
        matrix[:, first : first + unit.shape[1]] = model(unit)
    return np.asarray(0.5 * (matrix + matrix.T))
