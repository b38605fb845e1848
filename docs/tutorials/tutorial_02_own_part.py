"""
A part of your own
==================

A mesh with named boundaries becomes a problem in a few lines. Here it is made by scikit-fem;
``rm.read_mesh("part.msh")`` reads one of gmsh with its physical groups.
"""

# %%
# A block with a sloped upper edge.

import numpy as np

import rmesh_nlp as rm

mesh = rm.shapes.rectangle(12, 4, x=(0.0, 3.0))
x, y = mesh.p
sloped = np.vstack([x, y * (1 - 0.1 * x)])
mesh = type(mesh)(sloped, mesh.t, _boundaries=mesh.boundaries)
print(sorted(mesh.boundaries))

# %%
# Its law, where it is fixed, what it may touch, what loads it, and how far its nodes may move.

problem = rm.ContactProblem(
    mesh=mesh,
    law=rm.PlaneStress.from_young(young=2000.0, poisson=0.3),
    dirichlet=("left",),
    obstacle=rm.Obstacle.graph("bottom", lambda x, y: -0.01 * x, friction=2.0),
    tractions=(rm.Traction("top", (0.0, -6.0)),),
    motion=rm.Motion(delta=rm.Relative(0.3)),
    name="part",
)
before = rm.solve(problem, "fixed")
after = rm.solve(problem, "joint")
print(after.status.value, before.energy, after.energy)

# %%

rm.plot(before, after, what="stress")

# %%
# One uniform refinement is the other way to a better solution. What does it give?

from rmesh_nlp.problem import refined as finer

refined = rm.solve(finer(problem), "fixed")
print(f"relocated, {mesh.p.shape[1]} nodes: lower by {before.energy - after.energy:.3g}")
print(f"refined, {refined.mesh.p.shape[1]} nodes: lower by {before.energy - refined.energy:.3g}")

# %%
# The solution with all its fields, for ParaView.

import tempfile
from pathlib import Path

with tempfile.TemporaryDirectory() as folder:
    rm.write_solution(after, Path(folder) / "part.vtu")
    print([path.name for path in Path(folder).iterdir()])

# %%
# The picture, and the number: what the foundation carries, on the mesh as given, relocated and refined. They
# agree to 3 %.

rm.plot(before, after, what="pressure")
print([round(one.contact["bottom"]["normal_force"], 3) for one in (before, after, refined)])
