"""Studies: a matrix of problems and formulations, on all cores or a cluster, resumed at any moment.

A study file (:mod:`~rmesh_nlp.study.study_file`) becomes a plan of solves with content keys
(:mod:`~rmesh_nlp.study.plan`), which workers perform (:mod:`~rmesh_nlp.study.engine`), each solve in a
process that a hang or a leak cannot leave (:mod:`~rmesh_nlp.study.contained`), one row each
(:mod:`~rmesh_nlp.study.rows`).
"""
