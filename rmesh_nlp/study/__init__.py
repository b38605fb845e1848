"""Studies: a matrix of problems and formulations, on all cores or a cluster, resumed at any moment.

A study file becomes a plan of solves with content keys, which workers perform, one row each.

What other folders use of its modules:

- ``comparison``
- ``engine``
- ``environment``: environment
- ``plan``: make_plan, planned, PlannedSolve, seconds_of_plan
- ``progress``: in_words, SolvesProgress
- ``reproduction``: reproduce, Statement
- ``runner``: Done, INTERRUPTED, perform
- ``study_file``: is_study, read_study
"""
