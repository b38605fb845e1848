"""A solve of an MPCC whose NLPs end as a test says: what is tested is what the method makes of that."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from rmesh_nlp.mpcc import MPCC, Options
from rmesh_nlp.mpcc.lifting import Lifted, lift
from rmesh_nlp.mpcc.lpec import Linearisation, linearise
from rmesh_nlp.mpcc.nlps import CompiledNLPs
from rmesh_nlp.mpcc.result import Stage
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.solver import NLPResult
from rmesh_nlp.optimize.status import Status

x, y, w = (ca.SX.sym(name) for name in "xyw")
XY, XYW = ca.vertcat(x, y), ca.vertcat(x, y, w)
ON_G = np.array([[True], [False]])
"""Which members of a single pair are zero."""
START = np.array([0.5, 0.5])


def two_minima() -> MPCC:
    """Minima (0, 1) with f = 4 and (2, 0) with f = 1."""
    return MPCC(XY, (x - 2) ** 2 + (y - 1) ** 2, None, x, y)


def linearised(mpcc: MPCC, point: Sequence[float]) -> tuple[Lifted, Linearisation]:
    """The lifted problem and its linearisation at a point, with tolerances 1e-5 and 1e-6."""
    lifted = lift(mpcc)
    z = lifted.start(np.asarray(point, dtype=float), np.zeros(0))
    return lifted, linearise(lifted, z, np.ones(1), 1e-5, 1e-6)


def run_of(mpcc: MPCC, **options: Any) -> Run:
    """A run of an MPCC without parameters."""
    nlps = CompiledNLPs(mpcc, Options(**options))
    return Run(nlps, np.zeros(nlps.lifted.nlp.n_x), np.zeros(0))


def ended(x: Sequence[float], status: Status = Status.CONVERGED, f: float = 0.0, **changes: Any) -> NLPResult:
    """A result of an NLP in the two unknowns, with one row of a relaxation."""
    parts = {"g": np.zeros(1), "lam_x": np.zeros(2), "lam_g": np.zeros(1)} | changes
    return NLPResult(np.array(x, float), f, **parts, status=status, iterations=3, history={}, seconds=0.5)


@dataclass(frozen=True)
class Call:
    """A relaxation that was asked for."""

    z: np.ndarray
    t: float
    warm: NLPResult | None
    is_leap: bool = False


@dataclass(frozen=True)
class Answer:
    """How it ends."""

    x: Sequence[float] = (1.0, 0.5)
    status: Status = Status.CONVERGED
    product: float = 0.0
    objective: float = 0.0
    cost: float = 1.0
    """Of the pairs, to first order."""


class ScriptedRun(Run):
    """A run on `two_minima`, or another program, whose relaxations are answered by a function."""

    def __init__(
        self,
        relaxations: Callable[[Call], Answer] | None = None,
        exact: Callable[[np.ndarray], bool] | None = None,
        mpcc: MPCC | None = None,
        weight: float = 1.0,
        **options: Any,
    ) -> None:
        super().__init__(CompiledNLPs(mpcc or two_minima(), Options(**options)), START, np.zeros(0), weight)
        self.answered_cost = 1.0
        self.relaxations, self.is_exact = relaxations, exact
        self.calls: list[Call] = []

    @property
    def ts(self) -> list[float]:
        """t of each relaxation."""
        return [call.t for call in self.calls]

    def relaxed(self, z, t, warm=None, *, last=False, **how):  # type: ignore[no-untyped-def]
        self.calls.append(Call(z, t, warm, last))
        answer = self.relaxations(self.calls[-1])
        measured = {"objective": answer.objective, "constraint_violation": 0.0, "complementarity": 0.0}
        self.steps.append(
            Stage(phase="relaxed", t=t, **measured, product=answer.product, status=answer.status)
        )
        self.answered_cost = answer.cost
        return ended(answer.x, answer.status)

    def cost(self, result: NLPResult, t: float) -> float:
        return self.answered_cost

    def exact(self, z: np.ndarray) -> bool:
        return super().exact(z) if self.is_exact is None else self.is_exact(z)
