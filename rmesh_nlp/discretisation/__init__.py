"""A contact problem discretised once: numbering, fields, element terms, quadrature, validity of elements."""

from rmesh_nlp.discretisation.discretisation import Discretisation, discretise
from rmesh_nlp.discretisation.numbering import Numbering

__all__ = ["Discretisation", "Numbering", "discretise"]
