"""What all formats share: a case, odd numbers and words, and damage to bytes and to lines."""

import random
from collections.abc import Callable
from dataclasses import dataclass

NUM_POINTS = 12


@dataclass(frozen=True)
class Case:
    """A file to read.

    Attributes:
        content: The file.
        what: What was done to it.
        damaged: Whether the file alone tells that it is damaged, so that it must be refused.
        ending: Of its name, where the format has several.
        sound: Whether nothing was damaged, so that it must be read.
    """

    content: bytes
    what: str
    damaged: bool
    ending: str = ""
    sound: bool = False


Mutator = Callable[[random.Random], Case]

COUNTS = (0, 1, 2, 11, 13, 127, 255, 65_535, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64, 10**17)
WORDS = (
    "", "0", "-1", "1e999", "-1e999", "nan", "inf", "-inf", "1_000", "0x10", "１２", "3,158",
    "1e30", "true", "None", "[]", "{}",
    "'", '"', "#", "\\", "%s%n", "../x", "\x1b[31m", "9" * 25, "9" * 5000,
    "1" + "0" * 400, "a" * 300, "(" * 300, "[" * 3000, "a." * 3000, "💥",
)  # fmt: skip
"""Stand in for a number or a word where none of them may be."""


def points(rng: random.Random, number: int = NUM_POINTS) -> list[tuple[float, float, float]]:
    return [tuple(round(rng.uniform(-5, 5), 3) for _ in range(3)) for _ in range(number)]  # type: ignore[misc]


def wrong_count(rng: random.Random, right: int) -> str:
    """A count that is not the right one, as text."""
    choice = rng.random()
    if choice < 0.4:
        return str(rng.choice([count for count in COUNTS if count != right]))
    if choice < 0.5:
        return "9" * rng.choice((18, 19, 25, 4300, 5000))
    if choice < 0.6:
        return str(-rng.randint(1, 99))
    return str(right + rng.choice((-3, -2, -1, 1, 2, 3, 1000)))


def flipped(rng: random.Random, content: bytes) -> bytes:
    """Change some bytes, anywhere."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 5, 20))):
        place = rng.randrange(len(data))
        data[place] = rng.choice(
            (data[place] ^ (1 << rng.randrange(8)), rng.randrange(256), 0, 255)
        )
    return bytes(data)


def shuffled(rng: random.Random, content: bytes) -> bytes:
    """Cut a piece out, or copy one to another place."""
    start, stop = sorted(rng.randrange(len(content) + 1) for _ in range(2))
    if rng.random() < 0.5:
        return content[:start] + content[stop:]
    place = rng.randrange(len(content) + 1)
    return content[:place] + content[start:stop] * rng.choice((1, 2, 50)) + content[place:]


def with_word(rng: random.Random, content: bytes) -> bytes:
    """Replace a word of a text by an odd one."""
    words = content.split(b" ")
    words[rng.randrange(len(words))] = rng.choice(WORDS).encode()
    return b" ".join(words)


def with_digits(rng: random.Random, content: bytes) -> bytes:
    """Replace a digit of a text."""
    places = [place for place, byte in enumerate(content) if chr(byte).isdigit()]
    if not places:
        return content
    place = rng.choice(places)
    return (
        content[:place] + rng.choice((b"", b"9", b"-", b"00", b"e9", b".")) + content[place + 1 :]
    )


def at_random(rng: random.Random, content: bytes) -> Case:
    """Damage that the file alone need not tell."""
    if rng.random() < 0.1:
        return Case(content, "nothing", damaged=False, sound=True)
    kind = rng.choice((flipped, flipped, flipped, shuffled, with_word, with_digits))
    return Case(kind(rng, content), kind.__name__, damaged=False)


def cut(rng: random.Random, content: bytes, least: int = 1) -> Case:
    """Cut off the end."""
    return Case(content[: len(content) - rng.randint(least, len(content))], "cut", damaged=True)


def surplus(rng: random.Random, content: bytes) -> Case:
    """Add to the end."""
    more = bytes(rng.randrange(256) for _ in range(rng.randint(1, 40)))
    return Case(content + more, "surplus", damaged=True)
