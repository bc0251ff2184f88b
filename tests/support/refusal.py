"""What every refusal promises: one line that names the place and the rule."""

from collections.abc import Callable

import pytest

from gpgrad_core.errors import InputError


def assert_refused(action: Callable[[], object], *parts: str) -> None:
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert part in message
