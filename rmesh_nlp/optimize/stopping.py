"""How a solver is ended that has no other way to be told."""


class StoppedError(Exception):
    """A monitor asked to stop."""
