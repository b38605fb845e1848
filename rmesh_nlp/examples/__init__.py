"""The paper's examples, and reference solutions for those without an exact one.

What other folders use of its modules:

- ``paper``: as_size, PRINTED_DIGITS, RULES, truncated
- ``random_problems``: random_problem
- ``reference``: with_reference
"""

from rmesh_nlp.examples.paper import (
    EXACT_ENERGY_61,
    EXAMPLES,
    PAPER,
    Delta,
    PaperValues,
    Size,
)

__all__ = ["EXACT_ENERGY_61", "EXAMPLES", "PAPER", "Delta", "PaperValues", "Size"]
