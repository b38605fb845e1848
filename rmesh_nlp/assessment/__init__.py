"""What a mesh is worth to the continuous problem: the exact energy of an admissible displacement.

What other folders use of its modules:

- ``admissible``: Admissible, admissible
- ``contact_results``: contact_results, ContactResult, unlimited_peaks, worse
- ``coulomb``: coulomb_residual, growth
- ``energy``: friction_energy, load_vector
- ``error_reduction``: by_certificate, error_reduction, ErrorReduction, on_refined, SLOWEST
- ``integrals``: over_edges, over_triangles, RULES
- ``measures``: ContactResiduals, corrections, residuals
- ``parts``: edge_parts, refined, triangle_parts
"""
