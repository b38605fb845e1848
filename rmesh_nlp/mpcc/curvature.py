"""Second-order test of a stationary point along the critical cones of its branches.

With multipliers of S, a direction d is critical if it keeps every active row, bound and member that has a
multiplier, does not violate those without one, and on a biactive pair without multipliers keeps one of the
two members at zero. A minimum has no negative curvature of the Lagrangian along it if its multipliers
are unique. Nocedal and Wright, Numerical Optimization, 2006, theorem 12.5, on each branch.
"""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import Array, is_finite, magnitude
from rmesh_nlp.mpcc.finish import Finish
from rmesh_nlp.mpcc.lower_level import MOST, directions, least_critical, least_eigenvalue
from rmesh_nlp.mpcc.multipliers import columns_of
from rmesh_nlp.mpcc.run import Run
from rmesh_nlp.optimize.activity import ZERO


def descent_of_curvature(run: Run, end: Finish) -> tuple[str, Array | None]:
    """The finding in words, and a critical direction of negative curvature if there is one.

    ``"not negative"``, ``"negative"``, or ``"not tested"``: no finite Hessian, no S, or too large.
    """
    own, lin, lifted = end.stationarity.multipliers, end.lin, run.lifted
    if own is None or lin is None or end.stationarity.label != "S":
        return "not tested", None
    if lifted.base.hess_lag is None or lifted.nlp.n_x > MOST:
        return "not tested", None
    columns = columns_of(lifted, lin)
    hessian = lifted.curvature(end.z, run.p, own.rows)
    if not is_finite(hessian):
        return "not tested", None
    flat = ZERO * magnitude(hessian)
    gradients = columns.matrix.T.toarray()
    one_sided = (columns.may_fall ^ columns.may_rise) | columns.corner
    strong = ~one_sided | (np.abs(columns.gathered(own)) > run.options.stationarity * lin.scale)
    sign = np.where(columns.may_fall, 1.0, -1.0)[~strong]  # a lower bound: the value may only rise
    weak = -sign[:, None] * gradients[~strong]
    if least_eigenvalue(hessian, directions(gradients[strong]))[0] >= -flat:
        return "not negative", None
    value, d, is_complete = least_critical(hessian, gradients[strong], weak, columns.pair[~strong])
    if value < -flat:
        return "negative", d
    return "not negative" if is_complete else "not tested", None
