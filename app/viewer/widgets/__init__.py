"""What the panels share: actions, small HTML, legend, lists, status line, work bar, commands."""
