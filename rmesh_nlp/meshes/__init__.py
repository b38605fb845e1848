"""Meshes in: arrays, files, and simple shapes, with named boundaries and subdomains."""

from rmesh_nlp.meshes.reading import MeshRepairWarning, from_arrays, named, read_mesh

__all__ = ["MeshRepairWarning", "from_arrays", "named", "read_mesh"]
