"""The viewer and the command line of gpgrad."""
