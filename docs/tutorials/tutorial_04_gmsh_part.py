"""
A part from gmsh
================

From a gmsh file to a decision: describe the problem in a file, check it, solve it, and see
whether one refinement would have gained more. It needs gmsh: ``pip install 'rmesh-nlp[gmsh]'``.
"""

# %%
# The part: a plate with a hole, 20 x 10 mm. The names of the physical groups are the boundaries
# of the problem; the physical surface is the body.

import tempfile
from pathlib import Path

import gmsh

folder = Path(tempfile.mkdtemp())
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
occ = gmsh.model.occ
occ.cut([(2, occ.addRectangle(0, 0, 0, 20, 10))], [(2, occ.addDisk(12, 5, 0, 2, 2))])
occ.synchronize()
names: dict[str, list[int]] = {"left": [], "bottom": [], "top": [], "hole": []}
for _, curve in gmsh.model.getEntities(1):
    x0, y0, _, x1, y1, _ = gmsh.model.getBoundingBox(1, curve)
    if x1 < 0.01:
        names["left"].append(curve)
    elif y1 < 0.01:
        names["bottom"].append(curve)
    elif y0 > 9.99:
        names["top"].append(curve)
    elif x1 - x0 > 3.9:
        names["hole"].append(curve)
for name, curves in names.items():
    gmsh.model.addPhysicalGroup(1, curves, name=name)
gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntities(2)], name="body")
gmsh.option.setNumber("Mesh.MeshSizeMax", 1.6)
gmsh.model.mesh.generate(2)
gmsh.write(str(folder / "plate.msh"))
gmsh.finalize()

# %%
# The problem as a file, as ``rmesh new plate.toml`` would begin it. The hole is a circle: its nodes slide
# along it, and refinement puts new nodes on it.

(folder / "plate.toml").write_text(
    """
[mesh]
file = "plate.msh"

[boundaries]
load = "y > 9.99 and x > 10"

[curves]
hole = "circle"

[material]
law = "plane-strain"
young = 210000.0
poisson = 0.3

[dirichlet]
left = [0, 0]

[tractions]
load = [0, -600]

[contact]
boundary = "bottom"
height = -0.02
friction = 5.0

[motion]
delta = { relative = 0.3 }

[units]
length = "mm"
force = "N"
"""
)

import rmesh_nlp as rm

problem = rm.read_problem(folder / "plate.toml")
print(problem.mesh.p.shape[1], "nodes; boundaries", sorted(problem.mesh.boundaries))

# %%
# The warnings of ``rmesh check``. An empty list means that it found no sign of a wrong set-up.

from rmesh_nlp.contact.setup_warnings import setup_warnings
from rmesh_nlp.contact.solver import ContactSolver

print([warning.message for warning in setup_warnings(ContactSolver(problem))])

# %%
# Before and after. No formulation needs to be named: ``rmesh solve plate.toml`` does the same, and draws.

before = rm.solve(problem, "fixed")
after = rm.solve(problem)
print(after.status.value, f"{before.energy:.6g} -> {after.energy:.6g}")
print(after.record().get("warnings"))

# %%

rm.plot(before, after, what="stress")

# %%
# Relocate or refine? One uniform refinement is the gain to beat: ``rmesh compare plate.toml`` prints both.

from rmesh_nlp.problem import refined as finer

refined = rm.solve(finer(problem), "fixed")
print(f"relocated, {problem.mesh.p.shape[1]} nodes: lower by {before.energy - after.energy:.3g}")
print(f"refined, {refined.mesh.p.shape[1]} nodes: lower by {before.energy - refined.energy:.3g}")

# %%
# It lowers the energy two and a half times as much here, so refine first. Take the relocated mesh where
# the number of nodes counts. This writes it for other software, names kept:

from rmesh_nlp.io.export import write_mesh

write_mesh(after.mesh, folder / "moved.msh")
print(sorted(rm.read_mesh(folder / "moved.msh").boundaries))

# %%
# The picture, and the number: what the foundation carries on the mesh as given and on its refinement, in N
# per mm.

rm.plot(before, after, what="pressure")
print([round(one.contact["bottom"]["normal_force"], 1) for one in (before, refined)])
