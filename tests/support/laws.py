"""How many examples a law is tried with."""

from collections.abc import Callable
from typing import Any

from hypothesis import settings

FEWEST = 3


def examples(count: int, **options: Any) -> Callable[[Any], Any]:
    """Try a law with so many examples where the profile tries 100, and in proportion elsewhere.

    It is for laws whose examples take long, so that a quick run stays quick; see
    tests/conftest.py for the profiles.
    """
    share = settings().max_examples / 100
    return settings(max_examples=max(FEWEST, round(share * count)), **options)
