"""The link in a box with a button that copies it; and the script that keeps the address."""

import viser

from app.viewer.host import Host
from app.viewer.links.address import LONGEST
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import run_when_shown
from app.viewer.widgets.html import paragraph

NO_LINK = (
    "This dataset has no link, because it was uploaded or has no path on the server. Save the "
    "session instead."
)


class LinkPanel:
    """The link of the page that shows it: each page has a camera, so each has a link of its own."""

    def __init__(self, host: Host) -> None:
        """Make the widgets in the current container."""
        self._body = host.gui.add_html(link_html(has_link=True))

    def show(self, *, has_link: bool) -> None:
        """Show the link, or say that there is none."""
        content = link_html(has_link=has_link)
        if self._body.content != content:
            self._body.content = content


def script_html() -> str:
    """Write the script, for a place that is always mounted."""
    return run_when_shown(fill_page_file("links.js", MOST_LETTERS=LONGEST + 1))


def link_html(*, has_link: bool) -> str:
    """Write the box with the link, and the button that copies it."""
    if not has_link:
        return paragraph(NO_LINK, "opacity:.8")
    intro = paragraph(
        "The address of this page follows what is shown: dataset, pair, parameters, layers and "
        "camera. Whoever opens it on this viewer sees the same."
    )
    fill = run_when_shown(
        "window.gpgradLink&&(this.parentNode.querySelector('input').value=gpgradLink.link())"
    )
    return intro + fill_page_file("link.html", FILL=fill)


def tell(page: viser.ClientHandle, title: str, body: str) -> None:
    """Say something about a link to the page that it concerns."""
    page.add_notification(title, body, auto_close_seconds=12.0, with_close_button=True)
