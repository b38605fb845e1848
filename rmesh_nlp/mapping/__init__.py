"""Outer variables q -> node positions: move limits, curves, ties, and validity of elements."""

from rmesh_nlp.mapping.mesh_map import MeshMap, Mobility

__all__ = ["MeshMap", "Mobility"]
