"""The outer problem in its several forms: energy program, KKT program, reduced function."""
