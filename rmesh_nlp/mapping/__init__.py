"""Outer variables q -> node positions X(q): move limits, curves, ties, validity of elements.

What other folders use of its modules:

- ``mesh_map``: MeshMap, VertexParameters
- ``validity``: is_upright, is_valid, least_angles, least_area_ratio, Validity, validity
"""

from rmesh_nlp.mapping.mesh_map import MeshMap, Mobility

__all__ = ["MeshMap", "Mobility"]
