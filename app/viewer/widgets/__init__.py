"""What the panels share: small HTML, the status line, commands, modes, presence."""
