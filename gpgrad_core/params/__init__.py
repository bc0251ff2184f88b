"""Parameters: their bounds, their TOML files, and what can be known of a params dataclass."""
