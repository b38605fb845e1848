"""The models of the outer problem: energy NLP, KKT model (MPCC), reduced model; levels of meshes.

What other folders use of its modules:

- ``attainable``: LeastErrors
- ``branches``: Branches
- ``descent``: descend, Watch
- ``energy_nlp``: Relocation, relocation
- ``kkt_model``: Bilevel, bilevel, COMMON, ContactPoint, in_units_of, kkt_unknowns, TIGHT
- ``kkt_point``: KKTConditions
- ``levels``: coarsened, hierarchy, prolonged
- ``reduced_constraints``: ReducedConstraints
- ``reduced_model``: Reduced, ReducedEnergy, ReducedObjective, ReducedPoint
- ``reduced_nlp``: reduced_nlp
- ``regularisation``: gain_estimate, regularised, weights
- ``remeshing``: metric_start, Solved
- ``residual``: Multipliers, OuterResidual, released, size_of
"""
