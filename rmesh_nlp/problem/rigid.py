"""Rigid motions that the given displacements leave a body: what contact alone must prevent."""

from __future__ import annotations

import numpy as np

from rmesh_nlp.evaluation import ROUNDING, Array, Mask, magnitude
from rmesh_nlp.meshes.geometry import pieces_of
from rmesh_nlp.problem.data import ProblemData


def rigid_motions(problem: ProblemData, nodes: Array | None = None) -> Array:
    """A basis (motions, components, nodes) of the rigid motions that no given displacement prevents.

    Each belongs to one connected part of the mesh, or to a tool, and is zero on the others; ``nodes`` are the
    positions, by default as given. Tools come after the nodes.
    """
    mesh = problem.mesh
    p = mesh.p if nodes is None else nodes
    held, _ = problem.held
    part = pieces_of(mesh.facets, p.shape[1])
    motions = []
    for number in np.unique(part[mesh.t[0]]):
        modes = _modes(p, part == number, problem.components)
        if problem.axisymmetric:
            modes = modes[problem.components - 1 :][:1]  # along z
        motions += list(np.tensordot(kernel(modes[:, held].T), modes, 1))
    of_body = np.array(motions).reshape(-1, *held.shape)
    free = np.argwhere(~problem.tools_held.T)
    result = np.zeros((len(of_body) + len(free), len(held), held.shape[1] + len(problem.tools)))
    result[: len(of_body), :, : held.shape[1]] = of_body
    for motion, (tool, component) in zip(result[len(of_body) :], free, strict=True):
        motion[component, held.shape[1] + tool] = 1.0
    return result


def kernel(rows: Array) -> Array:
    """A basis (k, n) of what rows (m, n) take to zero."""
    # of a triangular factor: with all rows the other singular vectors, thousands, would be made as well
    _, sizes, directions = np.linalg.svd(np.linalg.qr(rows, mode="r"))
    return np.asarray(directions[np.sum(sizes > ROUNDING) :])


def in_words(problem: ProblemData, free: Array) -> str:
    """The name of a rigid motion of one part of the mesh; ``free`` (motions,) combines some of all."""
    if (tool := tool_of(problem, free)) is not None:
        return f"translation of the tool on {problem.obstacles[tool].boundary!r}"
    motions = rigid_motions(problem)[:, :, : problem.n_vertices]
    nodes, name = np.any(motions[np.argmax(np.abs(free))], axis=0), "translation"
    if problem.components == 2:
        # as complex numbers u = shift + turn z
        u = [1, 1j] @ np.tensordot(free, motions[:, :, nodes], 1)
        turn, shift = np.polyfit([1, 1j] @ problem.mesh.p[:, nodes], u, 1)
        turns = magnitude(u - u[0]) > ROUNDING
        at = np.round(-shift / turn if turns else shift / abs(shift), 9) + 0
        name = f"{'rotation about' if turns else 'translation along'} ({at.real:.6g}, {at.imag:.6g})"
    return (
        f"{name} of the part with node {np.argmax(nodes)}" + " (friction is not counted)" * problem.frictional
    )


def tool_of(problem: ProblemData, free: Array) -> int | None:
    """The obstacle that moves most where ``free`` (motions,) combines rigid motions; None of a body."""
    moved = np.any(rigid_motions(problem)[np.argmax(np.abs(free))], axis=0)[problem.n_vertices :]
    return problem.tools[np.argmax(moved)] if moved.any() else None


def _modes(p: Array, part: Mask, components: int) -> Array:
    """Translations, and for an elastic body the rotation, of one part: (modes, components, nodes)."""
    modes = np.zeros((2 * components - 1, components, p.shape[1]))
    for k in range(components):
        modes[k, k, part] = 1.0
    if components == 2:
        x, y = p[:, part] - p[:, part].mean(axis=1, keepdims=True)
        modes[2][:, part] = np.stack([-y, x]) / magnitude([x, y])
    return modes


def seen_by_contact(problem: ProblemData, motions: Array) -> Array:
    """Change of every gap (gaps, motions) by each motion."""
    rows = [np.zeros((0, len(motions)))]
    for part in problem.contact_sets:
        normals = problem.first_obstacles[part.number].normals(problem.mesh.p[:, part.nodes])
        rows.append(np.einsum("cn,mcn->nm", normals, part.relative(motions)[:, :, part.nodes]))
    return np.vstack(rows)
