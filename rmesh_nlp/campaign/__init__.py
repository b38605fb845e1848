"""Many solves: formulations by name, cases, and a row for each whatever happens."""
