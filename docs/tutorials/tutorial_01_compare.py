"""
Compare formulations for a paper
================================

Which formulation relocates best, and what does it cost? All of them solve one problem, are
assessed alike, and end in one table.
"""

# %%
# The obstacle problem of the paper (Example 6.1), on a small grid. A rule of degree 6 for the load
# keeps the optimiser from lowering the error of the rule instead of the energy.

from dataclasses import replace

import rmesh_nlp as rm

problem = replace(rm.EXAMPLES["6.1"](n=6), quadrature=6)
comparison = rm.compare(problem, ["fixed", "nested", "joint", "mpcc"])
comparison

# %%
# Audited energies are those of the contact problem solved once more, independently of the solver: loads
# by an adaptive rule, gaps along whole edges. Formulations are compared by them. The whole records are in
# ``comparison.frame()``, the tables of ``rmesh compare`` in ``comparison.markdown()``.

best = comparison.best
print(best.formulation, best.energy_audited)

# %%
# The meshes before and after.

rm.plot(comparison["fixed"], best, what="mesh")

# %%
# All descents are local. Random starts show how much another minimum gains.

several = rm.solve(problem, "joint", starts=4)
print(several.record()["start_energies"], "spread", several.record()["start_spread"])

# %%
# The picture, and the number: the audited energy of the best one. Extrapolated from refinements the least
# energy is -1.9456.

rm.plot(comparison["fixed"], best, what="displacement")
print(f"{comparison['fixed'].energy_audited:.4f} -> {best.energy_audited:.4f}")
