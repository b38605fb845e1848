"""Finite elements: element functions, their sums over a mesh, energies, stresses."""
