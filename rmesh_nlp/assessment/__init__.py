"""What a mesh is worth to the continuous problem: the exact energy of an admissible displacement."""
