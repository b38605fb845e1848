"""Finite elements: element functions, their sums over a mesh, energies, stresses.

What other folders use of its modules:

- ``assembly``: Assembled, element_values, Sums
- ``bernstein``: functions, SIDES, size, slopes, to_coefficients
- ``constraints``: boundary_of, checked, constraint_rows, ConstraintRows, is_constrained
- ``contact_pressure``: contact_stresses, is_even, nodal_forces, on_vertices, recovered, vertex_pressures
- ``contact_terms``: bound_force_groups, contact_force_groups, friction, gap_field, gaps, gradient_group,
  identity_group, slip_field, slips
- ``distortion``: DISTORTIONS
- ``edge_gaps``: with_edge_gaps
- ``energy``: displacement_field, loads, strain
- ``fields``: Bends, constant_field, Design, ElementGroup, Field, Fields, Forces, Modes, NONE, unknown_field
- ``functional``: as_row, Functional, scaled_group
- ``interpolation_error``: best_shapes, isotropic_errors, LARGEST_ASPECT, least_errors
- ``metric``: best_metric, Metric, nodal_areas
- ``objective``: Objective
- ``objective_text``: beside, load_of, parse_objective
- ``objectives``: ENERGY, energy
- ``pressure``: contact_on, LARGEST, level_name
- ``reach``: corners, least_areas
- ``recovery``: interpolation_error, Recovered, recovered
- ``sampling``: ALONG, along, edges_of, pieces, points_of, sampled
- ``space``: contact_edges, DisplacementSpace
- ``stress``: size_of_stress, stresses, von_mises
"""
