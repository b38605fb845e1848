"""Studies: a matrix of problems and formulations, on all cores or a cluster, resumed at any moment.

A study file becomes a plan of solves with content keys, which workers perform, one row each.
"""
