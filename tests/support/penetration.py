"""The deepest penetration of a displacement."""

from rmesh_nlp.contact.penetration import deepest, penetrations
from rmesh_nlp.evaluation import Array
from rmesh_nlp.fem.space import DisplacementSpace


def penetration(space: DisplacementSpace, nodes: Array, displacement: Array) -> float:
    """Over all contact sets, for vertices at ``nodes`` (2, vertices) and coefficients (components, nodes)."""
    return deepest(penetrations(space, nodes, displacement))
