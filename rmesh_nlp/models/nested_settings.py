"""Settings of the outer solvers of nested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from rmesh_nlp.optimize.newton_settings import LocalNewtonSettings, NewtonSettings
from rmesh_nlp.settings import Count, Positive, Settings


@dataclass(frozen=True)
class NestedSettings(Settings):
    """Settings of the outer solvers; docs/notes/speed.md has the benchmarks that chose them.

    Attributes
    ----------
    max_iterations : int or None
        Of the outer solver; by default 500, and 200 for newton.
    exact : int
        Number of moves up to which an interior point has the Hessian of an objective other than the energy, a
        dense matrix. That of the energy is sparse in moves and displacements together, for any number.
    along_areas : int
        Iterations after which newton-cg hands over to an interior point where element areas are constraints.
    tol_exact, acceptable_tol_exact : float
        Ipopt's least tolerances then, in units of the gradient on the given mesh. Many constraints are
        weakly active, and an interior point meets those only to the square root of its tolerance: it is the
        square of the strategy's ``tolerance`` where that is larger. Where rounding stops it before, the
        looser one will do.
    warm_barrier, warm_push : float
        Ipopt's first barrier and least distance to bounds where the start is given. Of 1e-4, 1e-6 and 1e-8,
        with six problems started at their minimisers and least areas that are smaller by 1e-4, 1e-8 took 4 to
        21 iterations and ended in the same valley each time; larger ones took more, and left it once.
    memory : int
        Updates that Ipopt's limited-memory BFGS keeps: the flat directions of the mesh make short
        memories stall.
    tol : float
        Ipopt's tolerance, in units of the objective on the given mesh. What the tolerance of the solve
        amounts to would be 1e-8 to 1e-7, where limited-memory BFGS stalls: on 6.2 it took 852 contact
        solves in place of 119, and the residual did not fall below 1e-4 of the initial one.
    boxed_curvature : float
        Curvature before any update where every node has a box. Moves are then in units of boxes and
        the objective in units of its first value, and Ipopt's 1 would make the first steps tiny, or
        all of them where the function is concave and no update is taken.
    tight : float
        newton ends where the point is stationary to the tolerance of the solve, and the model predicts
        less than this part of the gain so far.
    enough : float, optional
        newton ends where the model predicts less than this part of the gain so far, stationary or not; by
        default only at a stationary point. On a plate of 4,462 nodes with boxes 20 iterations of 200 and
        more have 99.7 % of the gain, after which the residual falls slowly.
    large_moves : float
        newton with a distortion in the objective ends where the model predicts less than this part of the
        gain so far.
    newton : NewtonSettings
        Numbers of the descents of newton.
    local_newton : LocalNewtonSettings
        Those of newton with a distortion in the objective.
    ipopt : mapping
        Further Ipopt options, which override all others.
    """

    max_iterations: Count | None = None
    exact: Count = 1500
    along_areas: Count = 40
    tol_exact: Positive = 1e-12
    acceptable_tol_exact: Positive = 1e-9
    warm_barrier: Positive = 1e-8
    warm_push: Positive = 1e-6
    memory: Count = 50
    tol: Positive = 1e-6
    boxed_curvature: Positive = 1e-2
    tight: Positive = 1e-4
    enough: Positive | None = None
    large_moves: Positive = 1e-15
    newton: NewtonSettings = field(default_factory=NewtonSettings)
    local_newton: LocalNewtonSettings = field(default_factory=LocalNewtonSettings)
    ipopt: Mapping[str, Any] = field(default_factory=dict)

    def options(self, boxed: bool) -> dict[str, Any]:
        """Ipopt's options."""
        found = {
            "hessian_approximation": "limited-memory",
            "limited_memory_max_history": self.memory,
            # after two skipped updates in a row Ipopt forgets the memory, and then crawls
            "limited_memory_max_skipping": 1_000_000,
            "tol": self.tol,
            "max_iter": self.max_iterations or 500,
        }
        if boxed:
            found["limited_memory_init_val"] = self.boxed_curvature
        return {**found, **self.ipopt}

    def exact_options(self, factor: float, warm: bool, tolerance: float) -> dict[str, Any]:
        """Ipopt's options where it has exact Hessians, and ``factor`` times the objective."""
        names = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")
        near = {"mu_init": self.warm_barrier, **dict.fromkeys(names, self.warm_push)}
        return {
            **(near if warm else {}),
            "tol": max(self.tol_exact, tolerance**2),
            "acceptable_tol": max(self.acceptable_tol_exact, tolerance**2),
            "max_iter": self.max_iterations or 500,
            "nlp_scaling_method": "none",
            "obj_scaling_factor": factor,
            **self.ipopt,
        }
