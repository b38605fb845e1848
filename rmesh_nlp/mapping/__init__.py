"""Outer variables q -> node positions X(q): move limits, curves, ties, validity of elements."""

from rmesh_nlp.mapping.mesh_map import MeshMap, Mobility

__all__ = ["MeshMap", "Mobility"]
