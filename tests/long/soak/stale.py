"""Is what the pages show what was asked for last? A viewer that knows nothing else says it."""

import random
import time
from collections.abc import Sequence

from app.viewer.features.params.tab import MAIN_PARAMETERS
from app.viewer.features.session import Session
from app.viewer.server.guard import open_server
from app.viewer.session.jobs import Capacity
from app.viewer.session.session_file import Opened, SavedSession, parse_session
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.params import get_path
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.threads import single_threaded_libraries
from gpgrad_core.simulation.demo import demo_path
from tests.long.soak.pages import MAIN, SoakPage, drag
from tests.support.page import ProtocolPage

QUIET = 1.0
"""Without a message for so long, a page has heard everything [s]."""
LOOKS = 3
"""A starved processor is quiet for as long in the midst of its work. What is stale stays so when
it is looked at again, and what was late does not."""
PATIENCE = 180.0
"""A picture that is not up to date after so long never will be [s]."""


def ask_and_compare(pages: Sequence[SoakPage], rng: random.Random) -> list[str]:
    """Drag sliders on one page, wait for quiet, and compare all pages with a fresh viewer.

    Returns:
        What is stale: empty if all is well.
    """
    first = rng.choice(pages)
    first.set("Mode", "Tune")
    # Nothing moves by itself: registered maps may blink.
    for label, option in (("Layout", "side by side"), ("Step association", "none")):
        first.set(label, option)
    first.set("Move the query", False)
    first.press("Clear the reading")
    _settle(pages)
    asked = {label: drag(first, label, rng, 15) for label in rng.sample(MAIN, 3)}
    stale: list[str] = []
    for _ in range(LOOKS):
        if not _settle(pages):
            return [f"after {PATIENCE:.0f} s: {_status(first)}"]
        stale = _stale(pages, first, asked)
        if not stale:
            break
    return stale


def _stale(pages: Sequence[SoakPage], first: SoakPage, asked: dict[str, float]) -> list[str]:
    """Compare all pages with what was asked for, and with a fresh viewer."""
    stale: list[str] = []
    for number, page in enumerate(pages):
        shown = {label: page.find(label)["value"] for label in asked}
        if shown != asked:
            stale.append(f"page {number} has {shown}, asked was {asked}")
    text = first.save_session()
    saved = parse_session(text, "saved")
    paths = {label: path for path, label in MAIN_PARAMETERS.items()}
    held = {label: get_path(saved.params, paths[label]) for label in asked}
    if held != asked:
        stale.append(f"the session has {held}, asked was {asked}")
    fresh = _drawn_afresh(saved)
    for number, page in enumerate(pages):
        drawn = _drawn(page)
        different = [name for name in fresh if fresh[name] != drawn.get(name)]
        if different:
            stale.append(
                f"page {number} shows another {', '.join(different)}: {drawn.get('verdict')} "
                f"instead of {fresh['verdict']}, for {text.decode()}"
            )
    return stale


def _settle(pages: Sequence[SoakPage]) -> bool:
    """Wait until all pages have heard everything, and say that they are up to date."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        before = [page.num_bytes for page in pages]
        time.sleep(QUIET)
        if before == [page.num_bytes for page in pages] and all(_rests(page) for page in pages):
            return True
    return False


def _rests(page: ProtocolPage) -> bool:
    """Say whether the picture is made, and no bar shows that other work goes on."""
    return "Up to date" in _status(page) and not any(
        widget["type"] == "GuiProgressBarMessage" and widget["props"]["visible"]
        for widget in list(page.widgets.values())
    )


def _status(page: ProtocolPage) -> str:
    lines = [
        str(widget["props"].get("content", ""))
        for widget in list(page.widgets.values())
        if 'data-testid="status"' in str(widget["props"].get("content", ""))
    ]
    return lines[0] if lines else ""


def _drawn(page: ProtocolPage) -> dict[str, object]:
    """Give the verdict, and all that is drawn of the pair but what is hidden."""
    drawn: dict[str, object] = {
        f"{name}.{prop}": value
        for name, props in list(page.nodes.items())
        if name.startswith("/pair")
        for prop, value in props.items()
        if prop in ("points", "colors")
    }
    for widget in list(page.widgets.values()):
        content = str(widget["props"].get("content", ""))
        if 'data-testid="verdict"' in content:
            drawn["verdict"] = content
    return drawn


@single_threaded_libraries()  # as in a viewer: the last bit of a sum depends on their number
def _drawn_afresh(saved: SavedSession) -> dict[str, object]:
    """Let a session that has seen nothing else draw what was saved."""
    source = saved.dataset or demo_path()
    dataset = load_dataset(source)
    server, _ = open_server("127.0.0.1", 0)
    opened = Opened(dataset, saved.params, str(source), saved)
    session = Session(server, opened, Memo(), Capacity())
    try:
        page = SoakPage(f"http://127.0.0.1:{server.get_port()}")
        assert session.wait_idle(PATIENCE)
        _settle([page])
        page.set("Mode", "Tune")
        _settle([page])
        drawn = _drawn(page)
        page.close()
    finally:
        session.close()
        server.stop()
    return drawn
