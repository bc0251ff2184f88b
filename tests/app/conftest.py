"""A server on a free port, without a browser."""

import contextlib
import io
from collections.abc import Iterator

import pytest
import viser


@pytest.fixture
def server() -> Iterator[viser.ViserServer]:
    with contextlib.redirect_stdout(io.StringIO()):
        made = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        yield made
        made.stop()
