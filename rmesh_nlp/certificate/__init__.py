"""Guaranteed bounds of the least energy by fields in equilibrium.

:func:`rmesh_nlp.solving.certify.certify` bounds the error of a solution with them.
"""


class NotCertifiableError(ValueError):
    """No certificate is known for this kind of problem; the message says which kind."""
