"""Parameters: their bounds, the fields of params dataclasses, and their TOML files."""
