"""
An MPCC of your own
===================

``rm.mpcc`` solves mathematical programs with complementarity constraints of any origin. Here is a
bilevel problem: the leader chooses x, the follower answers with the point y of [0, 1] nearest to x.
"""

# %%
# The follower's problem is replaced by its KKT conditions: stationarity, and one complementarity
# pair per bound.

import casadi as ca

import rmesh_nlp as rm

x, y, low, high = (ca.SX.sym(name) for name in ("x", "y", "low", "high"))
upper = (x - 3) ** 2 + (y - 2) ** 2
stationary = y - x - low + high
program = rm.MPCC(ca.vertcat(x, y, low, high), upper, stationary, [low, high], [y, 1 - y], lbg=0, ubg=0)
result = rm.solve_mpcc(program, 0.5)
print(result)

# %%
# The result is measured on this problem, not on a relaxation of it, and carries the strongest
# stationarity for which multipliers exist.

print("x, y:", result.x[:2], "stationarity:", result.stationarity, "B:", result.b_stationary)

# %%
# A local solver depends on its start; several starts tell how much.

best = rm.solve_mpcc(program, 0.5, starts=5)
print("best", best.f, "reached", *best.reached)

# %%
# ``rm.mpcc.bilevel`` writes the KKT conditions itself. Its results say whether the follower is at a
# minimum, which KKT conditions alone do not.

program = rm.mpcc.bilevel({"x": x, "f": upper}, {"f": (y - x) ** 2 / 2, "lbx": 0, "ubx": 1}, variables=y)
result = rm.solve_mpcc(program, 0.5)
print(result.x, result.lower_level)

# %%
# The picture, and the number: what the leader minimises over x when the follower answers has its minimum at
# x = 3, where it is 1, and kinks where the answer meets 0 and 1.

import numpy as np
from matplotlib import pyplot as plt

leader = np.linspace(-1.0, 4.0, 200)
figure, axes = plt.subplots()
axes.plot(leader, (leader - 3) ** 2 + (np.clip(leader, 0, 1) - 2) ** 2)
axes.plot(result.x[0], result.f, "o")
axes.set(xlabel="x", ylabel="f")
print(f"{result.f:.6f} at x = {float(result.x[0]):.6f}")
