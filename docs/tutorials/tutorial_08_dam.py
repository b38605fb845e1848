"""
A dam on rock
=============

Coulomb friction: the water pushes, the weight holds. How much of the friction is used?
"""

# %%
# ``docs/parts/dam.toml`` has the weight as a body force and the water as a traction that grows with depth.

import rmesh_nlp as rm

problem = rm.read_problem("../parts/dam.toml")
solution = rm.solve(problem, "fixed")
base = solution.contact["base"]

# %%
# With friction that depends on the pressure there is no energy that the displacement minimises: the contact
# problem is solved on the mesh as it is.

print(
    f"pressed by {base['normal_force'] / 1e6:.2f} MN, pushed by {base['tangential_force'] / 1e6:.2f} MN per m"
)

# %%
# The picture, and the number: the share of the friction that is used. Below 1 the dam stands.

rm.plot(solution, what="pressure")
print(f"{abs(base['tangential_force']) / (0.7 * base['normal_force']):.3f} of the friction")
