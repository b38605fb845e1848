"""Meshes in: arrays and simple shapes, with named boundaries and subdomains; files in ``reading``.

What other folders use of its modules:

- ``arrays``: from_arrays
- ``coarsening``: decimated, Lines
- ``curves``: Circle, Curve, fitted, FITTED, on_values, Parametrised, Spline
- ``embedding``: fault
- ``geometry``: counter_clockwise, EPSILON, have_same_mesh, last_digit, lengths, members_of, named_by_user,
  node_at, nodes_of, relocated_mesh, SEVEN_DIGITS, signed_areas
- ``mmg``: is_available, LARGEST, MISSING, remeshed
- ``reading``: read_mesh
- ``shapes``: rectangle
"""

from rmesh_nlp.meshes.arrays import MeshRepairWarning, from_arrays, named

__all__ = ["MeshRepairWarning", "from_arrays", "named"]
