"""Nonlinear programs (NLP) and descents; knows nothing of meshes.

What other folders use of its modules:

- ``activity``: both_vanish, BOUND_OF_AN_NLP, is_inside, ZERO
- ``budget``: Budget, deferred, LEAST_SECONDS, Limits, processor_seconds, StoppedError, timed
- ``callbacks``: Monitor, PythonFunction
- ``constraints``: LARGEST_DENSE, Linearised, stacked
- ``newton_step``: NewtonSettings
- ``nlp``: Derivatives, longer, NLP, Symbolic
- ``process``: PATIENCE_S, Process, serve
- ``solver``: LEAST_SHIFTS, NLPResult, PluginOptions, Solver
- ``status``: NOT_STATIONARY_YET, Status, success_in_words
- ``trust_region``: Evaluation, LocalRadii, minimise, NewtonResult
"""
