"""A viewer's server on a free port, without a browser."""

import contextlib
import io
from collections.abc import Iterator

import viser


@contextlib.contextmanager
def started_server() -> Iterator[viser.ViserServer]:
    """Start a server, which says nothing; it ends with the context."""
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        yield server
        server.stop()
