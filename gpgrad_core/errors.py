"""The one error that a user's input can cause."""


class InputError(ValueError):
    """An input cannot be used; the message is one line: what is wrong, where, and what to do."""
