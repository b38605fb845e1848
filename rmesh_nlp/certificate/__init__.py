"""Guaranteed bounds of the energy, and so of the error of a solution in the energy norm."""

from rmesh_nlp.certificate.certify import Certificate, certify
from rmesh_nlp.certificate.conditions import NotCertifiableError

__all__ = ["Certificate", "NotCertifiableError", "certify"]
