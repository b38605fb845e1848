"""Nonlinear programs (NLP) and descents; knows nothing of meshes."""
