"""One solve: the driver, what a formulation gets and returns, its assessment, the solution.

What other folders use of its modules:

- ``advice``: advise
- ``driver``: solve
- ``entries``: ENTRIES, versions
- ``entry``: Count, Digits, EVERY, Number, Seconds
- ``formulation``: check_taken, checked, Choice, Chooser, Formulation, taken, Wrapper
- ``monitor``: Monitor, OnStep, Track
- ``outcome``: continuous_energy, Outcome
- ``outer``: Outer, TOLERANCE
- ``parts``: DESIGN, FEW, HISTORY, plain, Step, Work
- ``plan``: COMPARED, compared, example_objective, Plan
- ``plotting``
- ``solution``: Solution
- ``state``: State
- ``summary``: contact_rows
"""
