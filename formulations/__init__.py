"""One formulation per module: a frozen dataclass whose fields are its settings."""
