"""The command ``rmesh``."""
