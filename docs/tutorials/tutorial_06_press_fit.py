"""
A press fit
===========

Two bodies of revolution: a hub is pressed into a ring that is too small by 0.0025 mm on the radius.
``docs/parts/press_fit.toml`` opens the line between them in one mesh.
"""

# %%
# An interface has nodes on both sides of it; their gap begins at minus the interference.

import rmesh_nlp as rm

problem = rm.read_problem("../parts/press_fit.toml")
solution = rm.solve(problem, "fixed")
solution

# %%
# Lamé's solution for radii a, b, c of one material has the pressure
# E d / b (b^2 - a^2) (c^2 - b^2) / (2 b^2 (c^2 - a^2)) everywhere.

a, b, c, young, interference = 10.0, 20.0, 30.0, 200e3, 0.0025
lame = young * interference / b * (b**2 - a**2) * (c**2 - b**2) / (2 * b**2 * (c**2 - a**2))

# %%
# The picture, and the number: the pressure in the fit, in N/mm^2.

rm.plot(solution, what="stress")
print(f"{solution.contact['fit']['peak_pressure']:.4f}, Lamé {lame:.4f}")
