"""How many pages share the session."""

from app.viewer.host import Host
from app.viewer.widgets.html import FAINT, paragraph


class PresenceLine:
    """A line that is empty while one page is open."""

    def __init__(self, host: Host) -> None:
        """Make it in the current container."""
        self._handle = host.gui.add_html("")

    def show(self, count: int) -> None:
        """Say how many pages are open on this session."""
        if count < 2:
            self._handle.content = ""
            return
        said = f"{count} pages share this session: all see and change the same."
        self._handle.content = f'<div data-testid="presence">{paragraph(said, FAINT)}</div>'
