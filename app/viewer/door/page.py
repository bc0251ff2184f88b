"""viser's page, with a script before all others: one that lets its address have a part after ``#``.

viser's client makes the address of its websocket from that of the page and cuts off only what
follows ``?``. A socket's address may have no ``#``, so a page that was opened with one and without
the other never connects. And as the client starts it writes the page's address anew, at times
without that part, which our links need.
"""

import gzip
from functools import lru_cache

from websockets.http11 import Response

HEAD = b"<head>"
SCRIPT = b"""<script>
if (location.hash) {
  const hash = location.hash;
  const write = url => History.prototype.replaceState.call(history, history.state, '', url);
  write(location.pathname + location.search);
  history.replaceState = (state, title, url) => {  // viser calls it once, when its socket is named
    delete history.replaceState;
    history.replaceState(state, title, url);
    write(location.pathname + location.search + hash);
  };
}
</script>"""


def add_script(response: Response) -> None:
    """Put the script into an answer, if that is the page."""
    if response.headers.get("Content-Type", "").startswith("text/html"):
        zipped = response.headers.get("Content-Encoding") == "gzip"
        response.body = _with_script(bytes(response.body or b""), zipped=zipped)
        del response.headers["Content-Length"]  # else it would be there twice
        response.headers["Content-Length"] = str(len(response.body))


@lru_cache(maxsize=2)  # as it is, and zipped
def _with_script(body: bytes, *, zipped: bool) -> bytes:
    page = gzip.decompress(body) if zipped else body
    page = page.replace(HEAD, HEAD + SCRIPT, 1)
    return gzip.compress(page) if zipped else page
