"""
Hertz: a roller on a plate
==========================

A part with a closed form, to see what a mesh is good for: ``docs/parts/roller.toml`` presses a round
roller of radius 10 mm on a plate by 40 N per mm of its length.
"""

# %%
# The file names the circle of the arc, so that edges are curved at order 2.

import numpy as np

import rmesh_nlp as rm

problem = rm.read_problem("../parts/roller.toml", order=2)
problem

# %%
# The peak of Hertz's pressure is sqrt(F E* / (pi R)), half the width of contact 2 F / (pi p).

force, radius, modulus = 40.0, 10.0, 1000.0 / (1 - 0.3**2)
peak = np.sqrt(force * modulus / (np.pi * radius))
solution = rm.solve(problem, "fixed")
finer = rm.solve(rm.refined(problem), "fixed")

# %%
# The picture, and the number: the peak on the mesh, on its refinement and of Hertz, in N/mm^2.

rm.plot(solution, finer, what="pressure")
print([round(one.contact["arc"]["peak_pressure"], 2) for one in (solution, finer)], f"Hertz {peak:.2f}")
