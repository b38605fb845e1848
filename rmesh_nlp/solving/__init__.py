"""One solve: the driver, what a formulation gets and returns, its assessment, the solution."""
