"""The paper's examples, and reference solutions for those without an exact one."""

from rmesh_nlp.examples.paper import (
    EXACT_ENERGY_61,
    EXAMPLES,
    PAPER,
    Delta,
    PaperValues,
    Size,
)

__all__ = ["EXACT_ENERGY_61", "EXAMPLES", "PAPER", "Delta", "PaperValues", "Size"]
