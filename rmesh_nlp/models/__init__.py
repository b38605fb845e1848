"""The models of the outer problem: energy NLP, KKT model (MPCC), reduced model; levels of meshes."""
