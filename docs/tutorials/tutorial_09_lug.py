"""
A pin in a lug
==============

Two bodies on a circle: a pin pulls in the bore of a lug, touches it in front and leaves it behind.
"""

# %%
# ``docs/parts/lug.toml`` is the upper half. Nothing but contact holds the pin along x.

import rmesh_nlp as rm

problem = rm.read_problem("../parts/lug.toml")
solution = rm.solve(problem, "fixed")
bore = solution.contact["bore"]
print(f"pressure up to {bore['peak_pressure']:.1f} N/mm^2 on {bore['contact_length']:.1f} of 31.4 mm")

# %%
# The picture, and the number: the force along x that goes through the bore must be the half of 2000 N
# per mm of thickness.

rm.plot(solution, what="stress")
print(f"{abs(bore['force_x']):.4f} N per mm")
