"""Save: the command that gives the same result, the session file, reports and exports."""
