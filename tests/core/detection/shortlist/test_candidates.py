"""How many candidates a word of the command line means."""

import pytest

from gpgrad_core.detection.shortlist import (
    ALL_UP_TO,
    DEFAULT_CANDIDATES,
    num_wanted,
    read_candidates,
)
from gpgrad_core.errors import InputError


@pytest.mark.parametrize("word", ["all", "automatic", "1", "30", "1000000"])
def test_words_that_are_read(word: str) -> None:
    assert str(read_candidates(word)) == word


@pytest.mark.parametrize("word", ["", "none", "-3", "3.5", "1e3", "٣", "0", "1000001", "All"])
def test_words_that_are_refused(word: str) -> None:
    with pytest.raises(InputError, match="candidates must be"):
        read_candidates(word)


def test_automatic_is_all_of_few_and_some_of_many() -> None:
    assert num_wanted("automatic", ALL_UP_TO) == ALL_UP_TO
    assert num_wanted("automatic", ALL_UP_TO + 1) == DEFAULT_CANDIDATES
    assert num_wanted("all", 10_000) == 10_000
    assert num_wanted(7, 3) == 3
    assert num_wanted(7, 0) == 0
