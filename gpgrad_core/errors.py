"""The one error that a user's input can cause."""


class InputError(ValueError):
    """What was given cannot be used; the message is one line: what, where, what to do."""
