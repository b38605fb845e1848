"""One module per strategy; each offers ``solve(problem, ...) -> Solution``."""
