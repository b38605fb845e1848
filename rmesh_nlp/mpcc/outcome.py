"""The end of a solve: the best point of all trajectories, why it stopped there, and the measured result.

Where it has failed, words name the unknowns: values that are not finite, the largest residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from rmesh_nlp.evaluation import Array, flat, is_finite, magnitude
from rmesh_nlp.mpcc.finish import Finish, finish, is_below
from rmesh_nlp.mpcc.homotopy import Path
from rmesh_nlp.mpcc.lifting import Lifted
from rmesh_nlp.mpcc.lower_level import DENSE
from rmesh_nlp.mpcc.names import FEW, in_short, named
from rmesh_nlp.mpcc.newton import curvature
from rmesh_nlp.mpcc.problem import MPCC
from rmesh_nlp.mpcc.result import MPCCResult, beyond
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.status import Status

_SADDLES, _LENGTH = 4, 0.1  # saddles that are left, and the length of a step from one, relative
_LARGE = 10_000  # most unknowns of a point whose curvature is tested
_HUGE = 1e15  # |f| or |x| beyond this: the iterates diverge
_NEARLY = 1e-6  # residual of a point so far away that is feasible, in units of its size
_UNTOLD = {Status.INFEASIBLE, Status.STALLED, Status.INACCURATE, Status.CONVERGED}
"""What a path may have ended with that says no more than that it was not at a solution."""


def best(paths: Sequence[Path]) -> Finish | None:
    """The lowest stationary end, if there is one; see :attr:`Finish.rank`."""
    return max((p.finish for p in paths if p.finish is not None), key=lambda end: end.rank, default=None)


def leave_saddles(run: Run, paths: list[Path]) -> None:
    """Go on beside ends with negative curvature, and keep what is lower."""
    lifted, random = run.lifted, np.random.default_rng(run.options.seed)
    for _ in range(_SADDLES):
        end = best(paths)
        if end is None or end.lin is None or end.stationarity.label != "S" or end.z.size > _LARGE:
            return
        own = end.stationarity.multipliers
        if own is None or lifted.base.hess_lag is None:
            return
        lam_z = own.z.copy()
        np.add.at(lam_z, lifted.pairs, own.pairs)
        run.curvature = curvature(run, end.z, end.lin, lam_z, own.rows)
        if run.curvature != "negative":
            return
        z = end.z + _LENGTH * (1.0 + magnitude(end.z)) * random.normal(size=end.z.size)
        z[lifted.pairs[end.lin.zero & ~end.lin.zero[::-1]]] = 0.0
        lower = finish(run, np.clip(z, lifted.nlp.lbx, lifted.nlp.ubx), search=False)
        if not (lower.solved and is_below(lower.f, end.f)):
            return
        paths.append(Path(finish=lower))


def end_of(run: Run, paths: Sequence[Path]) -> Finish:
    """The best point of all homotopies, and why the solve stopped there."""
    end, (z, f, excess) = best(paths), run.nearest
    ends = [path.finish for path in paths if path.finish is not None]
    points = [z, *(path.relaxed.x for path in paths if path.relaxed is not None), *(end.z for end in ends)]
    values = [run.measure(point) for point in points]
    # no minimum is told from a valley where unknowns have grown without end
    floor = 0.0 if end is None or magnitude(end.z) > _HUGE else min(2.0 * end.f / run.p[-1], 0.0)
    for point, (f_there, res, _) in zip(points, values, strict=True):
        if _is_bottomless(point, f_there - floor, res["constraint_violation"] + res["complementarity"]):
            return Finish(point, f_there, Status.UNBOUNDED)
    if end is not None and end.lin is not None:
        return end if end.solved or run.limit is None else replace(end, status=run.limit)
    if run.limit is not None:
        return Finish(z, f, run.limit)
    for point, (f_there, *_) in zip(points, values, strict=True):
        if f_there < -_HUGE or (is_finite(point) and magnitude(point) > _HUGE):
            return Finish(point, f_there, Status.UNBOUNDED)
    if run.is_infeasible and excess > 1.0:  # a local minimum of the violation was certified
        return Finish(z, f, Status.INFEASIBLE)
    said = [path.failure for path in paths if path.failure is not None] + [end.status for end in ends]
    return Finish(z, f, next((status for status in said if status not in _UNTOLD), Status.STALLED))


def _is_bottomless(x: Array, f: float, residual: float) -> bool:
    """Whether the objective falls without end, at points that are feasible in units of their size."""
    return bool(f < -_HUGE and residual <= _NEARLY * magnitude(x))


def result_of(run: Run, end: Finish) -> MPCCResult:
    """Measure the point on the source problem and put everything together."""
    lifted, mpcc = run.lifted, run.lifted.source
    f, res, values = run.measure(end.z)
    own = end.stationarity.multipliers
    column = np.full(values.size, np.nan)
    lam_x = np.full(mpcc.n_x, np.nan)
    if own is not None:
        column[mpcc.n_g :] = own.pairs.ravel()  # of members that keep their place
        column[lifted.rows] = own.rows
        column /= run.p[-1]
        lam_x = own.z[: mpcc.n_x] / run.p[-1]
    (lam_g, lam_G, lam_H), (g, G, H) = (
        np.split(part, [mpcc.n_g, mpcc.n_g + mpcc.n_pairs]) for part in (column, values)
    )
    level, check, status = mpcc.lower_level, None, end.status
    if level is not None and level.nlp.n_x <= DENSE:
        check = level.check(end.z[: mpcc.n_x], p=run.p[:-1], search=end.solved)
        if end.solved and check.verdict == "no minimum":
            status = Status.NO_MINIMUM
    total, build = run.watch.elapsed, run.nlps.build_seconds - run.built
    homotopy = sum(step.seconds for step in run.steps if step.phase == "relaxed")
    seconds = {"build": build, "homotopy": homotopy, "finish": total - build - homotopy, "total": total}
    where = ""
    if status is Status.EVALUATION_ERROR:
        where = where_not_finite(lifted, end.z[: mpcc.n_x], run.p[:-1])
    elif status in (Status.INFEASIBLE, Status.INACCURATE):
        # that a violation has a minimum may be shown before pairs are complementary
        is_shown = status is Status.INFEASIBLE and res["constraint_violation"] > run.options.feasibility
        where = largest_residual(mpcc, end.z[: mpcc.n_x], g, *np.minimum([G, H], 0.0 if is_shown else np.inf))
    return MPCCResult(
        x=end.z[: mpcc.n_x], f=f, status=status, success=end.solved and status is end.status,
        message=f"{status.message} {where}".strip(), lower_level=check, curvature=run.curvature,
        **res,
        stationarity=end.stationarity.label, b_stationary=end.stationarity.b_stationary,
        lam_x=lam_x, lam_g=lam_g, lam_G=lam_G, lam_H=lam_H, g=g, G=G, H=H,
        biactive=np.zeros(0, dtype=np.int64) if end.lin is None else end.lin.biactive,
        history=tuple(run.steps),
        counts={
            "nlp_solves": len(run.steps), "ipopt_iterations": run.iterations,
            "pivots": end.pivots, "rescues": run.rescues,
        },
        seconds=seconds,
    )  # fmt: skip


def best_of(ends: Sequence[MPCCResult]) -> MPCCResult:
    """The result of several starts: what any of them has proved counts, see :func:`_rank`.

    It has all of them, with counts and seconds that are sums. Those of one trajectory are one object.
    """
    if len(ends) == 1:
        return ends[0]
    best = min(ends, key=_rank)
    own = list(dict.fromkeys(ends))
    counts = {name: sum(r.counts[name] for r in own) for name in best.counts}
    seconds = {name: sum(r.seconds[name] for r in own) for name in best.seconds}
    return replace(best, ends=tuple(ends), counts=counts, seconds=seconds)


def _rank(end: MPCCResult) -> tuple[int, float]:
    """Sort key of an end of several starts.

    An objective without bound is below every minimum, and one feasible point refutes an infeasible program.
    """
    is_unbounded, residual = end.status is Status.UNBOUNDED, end.constraint_violation + end.complementarity
    is_proved = is_unbounded and _is_bottomless(end.x, end.f, residual)
    kinds = is_proved, end.success, is_unbounded, end.stationarity != ""
    if any(kinds):
        return kinds.index(True), end.f
    return len(kinds) + (end.status is not Status.INFEASIBLE), residual


def where_not_finite(lifted: Lifted, x: Array, p: Array) -> str:
    """The first function that is NaN or infinite at ``x``, with its unknowns, else the first such derivative.

    Nothing if all are finite.
    """
    mpcc, base = lifted.source, lifted.base
    f, gradient = base.grad_f(x, p)
    column, jacobian = base.jac_g(x, p)
    places = ["f", *(f"{part}[{i}]" for part in "gGH" for i in range(getattr(mpcc, part).shape[0]))]
    values, derivatives = flat(ca.vertcat(f, column)), ca.vertcat(gradient.T, jacobian)
    rows, columns = map(np.asarray, derivatives.sparsity().get_triplet())
    slopes = np.asarray(derivatives.nonzeros())
    if not is_finite(values):
        row = int(np.argmin(np.isfinite(values)))
        unknowns = columns[(rows == row) & (slopes != 0)]
        at = ", ".join(f"{named(mpcc.x, int(j))} = {x[j]:g}" for j in unknowns[:FEW])
        return f"{places[row]} is {values[row]} at {at}{', ...' if unknowns.size > FEW else ''}."
    if not is_finite(slopes):
        k = int(np.argmin(np.isfinite(slopes)))
        j = int(columns[k])
        return f"The derivative of {places[rows[k]]} is {slopes[k]} at {named(mpcc.x, j)} = {x[j]:g}."
    return ""


@np.errstate(invalid="ignore")
def largest_residual(mpcc: MPCC, x: Array, g: Array, G: Array, H: Array) -> str:
    """The constraint or pair that is farthest from holding, with its residual; nothing if all hold."""
    pairs = np.max([-G, -H, np.minimum(np.abs(G), np.abs(H))], axis=0)
    apart = [beyond(x, mpcc.lbx, mpcc.ubx), beyond(g, mpcc.lbg, mpcc.ubg), pairs]
    kind = int(np.argmax([np.max(part, initial=0.0) for part in apart]))
    if np.max(apart[kind], initial=0.0) <= 0.0:
        return ""
    i = int(np.argmax(apart[kind]))
    if kind == 0:
        place = f"the bounds of {named(mpcc.x, i)}"
    elif kind == 1:
        place = f"g[{i}], {in_short(mpcc.g[i])}"
    else:
        place = f"pair {i}, between {in_short(mpcc.G[i])} and {in_short(mpcc.H[i])}"
    return f"The largest residual, {apart[kind][i]:.1e}, is in {place}."
