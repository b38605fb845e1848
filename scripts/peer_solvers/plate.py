"""A plate with a hole, whose mesh is from a file: NeuROM-Py beside ``joint``."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from peer_solvers.case import Case, Finish

from rmesh_nlp.meshes import read_mesh
from rmesh_nlp.problem import ContactProblem, Dirichlet, Motion, PlaneStrain

EPOCHS = 10000
"""Iterations that NeuROM-Py may take, as in its own example."""

PLATE = {"bottom": 111, "right": 112, "top": 113, "left": 114, "hole": 115, "body": 100}
"""Physical groups of the plate's mesh file."""


def plate(mesh: Path) -> ContactProblem:
    """The stretched plate of ``scripts/gallery/plate_with_hole.py`` on a given mesh."""
    name = {key: f"boundary-{tag}" for key, tag in PLATE.items()}
    pinned = tuple(name[side] for side in ("bottom", "right", "top", "left", "hole"))
    return ContactProblem(
        mesh=read_mesh(mesh),
        law=PlaneStrain(lame_lambda=1.25, lame_mu=1.0),
        dirichlet=(name["bottom"], Dirichlet(name["top"], (0.0, 1.0))),
        motion=Motion(None, pinned=pinned, min_area_fraction=0.01),
        name="plate",
    )


def neurom(case: Case) -> Finish:
    """NeuROM-Py: positions and displacement trained together by the L-BFGS of PyTorch, in double precision.

    Stopping rule and line search are those of its own example of the plate.
    """
    arguments, sys.argv = sys.argv, sys.argv[:1]  # its import parses the command line
    import torch
    from neurom.HiDeNN_PDE import MeshNN_2D
    from neurom.src import Pre_processing
    from neurom.src.Training import Training_2_3D_FEM

    sys.argv = arguments
    assert case.mesh is not None
    sides = [PLATE[side] for side in ("bottom", "right", "top", "left", "hole")]
    held = [
        {"Entity": PLATE[side], "Value": value, "Normal": i, "Relation": False, "Constitutive": False}
        for side, values in (("bottom", (0, 0)), ("top", (0, 1)))
        for i, value in enumerate(values)
    ]
    config = {
        "training": {"n_epochs": EPOCHS, "multiscl_max_refinment": 1, "optimizer": "lbfgs"},
        "interpolation": {"MaxElemSize2D": 0.5},
        "solver": {"TrainingStrategy": "Integral", "volume_forces": False, "regul_term": False},
        "postprocess": {"ModularEpochsPrint": 10},
    }
    mesh_file = case.mesh.resolve()
    home = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # it reads and writes in fixed folders
        os.mkdir("Geometries")
        shutil.copyfile(mesh_file, "Geometries/plate_order_1_0.5.msh")
        began = time.perf_counter()
        mesh = Pre_processing.Mesh("plate", 0.5, 1, 2, welcome=False)
        mesh.AddBorders(sides)
        mesh.AddBCs(PLATE["body"], [], held)
        mesh.MeshGeo()
        mesh.ReadMesh()
        mesh.ExportMeshVtk()
        given = np.array(mesh.Nodes)[:, 1:3]
        model = MeshNN_2D(mesh, n_components=2)
        model.UnFreeze_FEM()
        model.to(torch.float64)
        model.UnFreeze_Mesh()
        model.RefinementParameters(MaxGeneration=1, Jacobian_threshold=0.3)
        model.TrainingParameters(loss_decrease_c=1e-7, Max_epochs=EPOCHS, learning_rate=0.001)
        model = Training_2_3D_FEM(model, config, Pre_processing.Material(True, 1.25, 1.0))
        seconds = time.perf_counter() - began
        os.chdir(home)
    moved = given.copy()
    moved[model.coord_free.numpy()] = model.coordinates["free"].detach().numpy()
    p = np.asarray(case.problem.mesh.p).T
    order = np.argmin(np.abs(p[:, None] - given[None]).sum(axis=2), axis=1)
    ended = len(model.training_recap["Loss_tot"]) < EPOCHS
    status = "converged" if ended else "iteration_limit"
    return Finish(np.ascontiguousarray(moved[order].T), status, seconds)
