"""Guaranteed bounds of the least energy by fields in equilibrium.

:func:`rmesh_nlp.solving.certify.certify` bounds the error of a solution with them.

What other folders use of its modules:

- ``bracket``: BENT, Bracket, refined_bracket, UNKNOWN
- ``equilibration``: Guess
- ``forces``: force_bounds, slope_bounds
- ``skeleton``: same_domain
"""


class NotCertifiableError(ValueError):
    """No certificate is known for this kind of problem; the message says which kind."""
