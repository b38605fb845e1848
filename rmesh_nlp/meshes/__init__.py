"""Meshes in: arrays and simple shapes, with named boundaries and subdomains; files in ``reading``."""

from rmesh_nlp.meshes.arrays import MeshRepairWarning, from_arrays, named

__all__ = ["MeshRepairWarning", "from_arrays", "named"]
