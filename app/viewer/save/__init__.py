"""Save: the command and the session file that find again what is shown, and exports."""
