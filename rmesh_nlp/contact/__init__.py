"""The inner problem: contact on a fixed mesh, solved exactly.

What other folders use of its modules:

- ``active_set``: solve
- ``factorisation``: factorised, HAS_CHOLMOD
- ``penetration``: deepest, penetrations
- ``sensitivity``: TangentResponse, weakly_active
- ``setup_warnings``: curve_warnings, penetration_warnings, setup_warnings, SetupWarning
- ``solver``: coefficients, ContactSolver, Directions
- ``standoff``: Cells, cells_of, LATTICES, SAMPLES
- ``system``: ActiveSet, ContactSystem, Equilibrium, OwnState
- ``uniqueness``: contraction
"""
