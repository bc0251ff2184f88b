"""The one error that a user's input can cause, and what other errors say."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

LONGEST = 2000
"""Characters of a message; a longer one loses its middle."""


class InputError(ValueError):
    """An input cannot be used; the message is one line: what is wrong, where, and what to do.

    Messages quote names and values that come from outside. So whatever a terminal would not print
    as it is, such as a line end or an escape, is spelled out here, for every message.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(_one_line(str(message)))


class NoTerrainError(InputError):
    """A cloud is sound, but no map can be made of it; a dataset can do without it."""


def _one_line(message: str) -> str:
    if not message.isprintable():
        message = "".join(_spelled(character) for character in message)
    if len(message) <= LONGEST:
        return message
    half = (LONGEST - 3) // 2
    return f"{message[:half]} … {message[-half:]}"


def _spelled(character: str) -> str:
    if character.isprintable():
        return character
    return " " if character.isspace() else f"\\x{ord(character):02x}"


@contextmanager
def readable(path: Path | str) -> Generator[None]:
    """Turn an error of the system, while it reads a file, into an InputError that names it."""
    try:
        yield
    except OSError as error:
        place, reason = error.filename or path, error.strerror or error
        raise InputError(f"{place}: cannot be read: {reason}") from None


@contextmanager
def writable(path: Path | str) -> Generator[None]:
    """Make an error of the system, while it writes a file, an InputError that names the file."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


def told_apart(
    value: float, least: float, form: str = ".3g", least_form: str = "g"
) -> tuple[str, str]:
    """Write a number and the least that is allowed with as many digits as show if it is below.

    For the most that is allowed, give that first.

    >>> told_apart(6.91, 7.0), told_apart(6.99996, 7.0), told_apart(7.001, 7.0)
    (('6.91', '7'), ('6.99996', '7'), ('7', '7'))
    """
    forms = [(form, least_form), *((f".{n}g", f".{max(n, 6)}g") for n in range(3, 18))]
    for texts in ((f"{value:{one}}", f"{least:{other}}") for one, other in forms):
        has, needs = (float(text.replace(",", "")) for text in texts)
        if (has < needs) == (value < least):
            return texts
    return repr(value), repr(least)


def score_in_words(score: float, least: float | None = None) -> str:
    """Write a score so that it reads as below the least of a loop closure if it is.

    Where that is not known, the score is rounded down, so that no least of two decimals is reached.

    >>> score_in_words(2.9996), score_in_words(2.9996, 2.5), score_in_words(3.05)
    ('2.99', '3.0', '3.05')
    """
    if least is not None:
        return told_apart(score, least, ".1f")[0]
    nearest = f"{score:.2f}"
    return nearest if float(nearest) <= score else f"{float(nearest) - 0.01:.2f}"


def count(number: int, what: str) -> str:
    """Write a number with its noun, in the singular or plural.

    >>> count(1, "scan"), count(1200, "scan")
    ('1 scan', '1,200 scans')
    """
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def message_of(error: BaseException) -> str:
    """The message of an error in one line; its type if it has none."""
    return " ".join(str(error).split()) or type(error).__name__
