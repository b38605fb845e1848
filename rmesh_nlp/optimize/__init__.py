"""Nonlinear programs and descents; knows nothing of meshes."""
