"""
An O-ring to 1 %
================

The force of a contact to an accuracy that you ask for: meshes are refined where it is decided.
"""

# %%
# ``docs/parts/o_ring.toml`` is half the section of a long ring between two plates, pressed by 0.5 mm.

import rmesh_nlp as rm

problem = rm.read_problem("../parts/o_ring.toml")
solution = rm.solve(problem, accuracy=0.01)
for name, estimate in solution.record()["estimates"].items():
    error = estimate["error"]  # None where it takes another mesh
    print(name, f"{estimate['value']:.5g}", "" if error is None else f"+- {error:.1g}")

# %%
# The picture, and the number: both plates carry the same force, in N per mm. A mesh refined twice has 0.5807.

rm.plot(solution, what="pressure")
print([f"{solution.contact[plate]['normal_force']:.4f}" for plate in ("lower", "upper")])
