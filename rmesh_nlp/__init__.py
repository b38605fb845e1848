"""Finite-element mesh relocation for contact problems, as a bilevel NLP and MPCC.

The sub-modules are imported by name (``from rmesh_nlp.examples import EXAMPLES``);
nothing heavy is loaded here, so that the command line starts at once.
"""

__version__ = "0.1.0"
