"""Guaranteed bounds of the least energy by fields in equilibrium.

:func:`rmesh_nlp.solving.certify.certify` bounds the error of a solution with them.
"""
