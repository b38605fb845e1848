"""Meshes in: arrays, files, and simple shapes, with named boundaries and subdomains."""

from rmesh_nlp.meshes.arrays import MeshRepairWarning, from_arrays, named
from rmesh_nlp.meshes.reading import read_mesh

__all__ = ["MeshRepairWarning", "from_arrays", "named", "read_mesh"]
