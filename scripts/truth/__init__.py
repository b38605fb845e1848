"""An independent judge: own assembly, contact solver, friction integral, reference meshes."""
