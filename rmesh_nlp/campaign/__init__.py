"""Many solves: strategies by name, cases, and a row for each whatever happens."""
