"""A contact problem discretised once: numbering, fields, element terms, quadrature, validity of elements."""

from rmesh_nlp.discretisation.discretisation import Discretisation, discretise

__all__ = ["Discretisation", "discretise"]
