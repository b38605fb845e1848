"""Which mesh is best: problems, methods and tables of ``benchmark_mesh.py`` and ``benchmark_order.py``."""
