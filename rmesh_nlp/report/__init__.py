"""Tables and figures from records; nothing is solved here."""
