"""A bracket with the equilibration on a finer mesh than that of the displacement.

The lower bound holds whatever mesh the field in equilibrium lives on. On few elements the field's own error
adds a fifth to a half of the true gap for elastic problems, and more where the edge of a contact zone in
the interior crosses large elements. On the mesh refined once it adds a third of that or less. The
displacement stays as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from skfem import MeshTri

from rmesh_nlp.certificate.bracket import Bracket, bracket
from rmesh_nlp.certificate.field import Guess
from rmesh_nlp.evaluation import Array
from rmesh_nlp.problem import ContactProblem, Motion

FEW = 500
"""Triangles up to which the equilibration is refined once unless asked otherwise: it takes less than a
tenth of a second there."""

PRODUCTS = 40
"""Back-substitutions that improve contact forces that come from a coarser mesh."""


def refined_bracket(
    problem: ContactProblem, nodes: Array, guess: Guess, refinements: int | None = None
) -> Bracket:
    """Bounds of the least energy, see :func:`rmesh_nlp.certificate.bracket.bracket`.

    Parameters
    ----------
    problem, nodes, guess
        As there.
    refinements : int, optional
        How often the mesh of the equilibration is refined, each time into four times as many triangles;
        by default once on up to ``FEW`` triangles, else not.

    Returns
    -------
    Bracket
        Its arrays run over the elements of the given mesh.
    """
    count = problem.mesh.t.shape[1]
    if refinements is None:
        found = refined_bracket(problem, nodes, guess, int(count <= FEW))
        # on needles rounding grows with refinement
        plain = found if found.guaranteed_lower or count > FEW else bracket(problem, nodes, guess)
        return plain if plain.guaranteed_lower else found
    mesh = replace(problem.mesh, doflocs=np.ascontiguousarray(nodes))
    for _ in range(refinements):
        guess = prolonged(guess, mesh)
        mesh = mesh.refined(1)
    if refinements == 0:
        return bracket(problem, nodes, guess)
    found = bracket(
        replace(problem, mesh=mesh, motion=Motion(None)), np.asarray(mesh.p), guess, products=PRODUCTS
    )
    children = 4**refinements
    return replace(
        found,
        local=found.local.reshape(children, count).sum(axis=0),
        field=found.field.reshape(-1, children, count).mean(axis=1),
    )


def prolonged(guess: Guess, mesh: MeshTri) -> Guess:
    """The same displacement and stresses on the mesh refined once, whose new nodes halve the edges."""

    def prolong(values: Array) -> Array:
        return np.concatenate([values, values[..., mesh.facets].mean(axis=-2)], axis=-1)

    return Guess(*(prolong(values) for values in (guess.displacement, guess.pressure, guess.friction)))
