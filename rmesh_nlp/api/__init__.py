"""What a script or a notebook calls; ``import rmesh_nlp as rm`` offers it all by name."""
