"""
A ball on a plate
=================

A body of revolution on a rigid plate. x is the radius and y the axis, and forces are of the whole
ball, not per unit of depth.
"""

# %%
# ``docs/parts/ball.toml`` is a quarter of the section; the axis needs no support of its own.

import numpy as np

import rmesh_nlp as rm

problem = rm.read_problem("../parts/ball.toml")
solution = rm.solve(problem, "fixed")
force = solution.contact["contact"]["normal_force"]
print(f"force {force:.5g} N; the load on the section through the equator is {5e5 * np.pi * 6.1237**2:.5g} N")

# %%
# The peak of Hertz's pressure is (6 F E*^2 / (pi^3 R^2))^(1/3).

modulus, radius = 1e8 / (1 - 0.29**2), 6.1237
hertz = (6 * force * modulus**2 / (np.pi**3 * radius**2)) ** (1 / 3)

# %%
# The picture, and the number: the peak, in N/m^2. The contact is a fifth of the radius wide, and the ball
# is no half-space any more: Hertz is 1 % off.

rm.plot(solution, what="pressure")
print(f"{solution.contact['contact']['peak_pressure']:.4g}, Hertz {hertz:.4g}")
