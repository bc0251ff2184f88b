"""The values of the place that was clicked on."""

from collections.abc import Callable
from html import escape

from app.viewer.host import Host
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.html import BUSY, FAINT, paragraph, table

HOW = "Hold Shift and click a surface to read its values."


class ReadingPanel:
    """A card of values that follow the sliders, and a button that clears it."""

    def __init__(self, host: Host, on_clear: Callable[[], None]) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            on_clear: Called when the place is no longer wanted.
        """
        self._card = host.gui.add_html(paragraph(HOW, FAINT))
        self._clear = host.gui.add_button(
            "Clear the reading", visible=False, hint="Removes the mark from the surface."
        )

        on_press(self._clear, on_clear)

    def show(self, title: str, rows: tuple[tuple[str, str], ...], *, trusted: bool) -> None:
        """Show the values of a place.

        Args:
            title: Whose surface it is.
            rows: Names and values.
            trusted: Whether the variance mask lets the place pass.
        """
        warning = (
            ""
            if trusted
            else f'<div style="color:{BUSY};font-size:.8em">The variance mask rejects this place: '
            "there are no points near.</div>"
        )
        self._card.content = (
            f'<div data-testid="reading" style="padding:.1em .75em .3em">'
            f'<div style="font-size:.85em;font-weight:600">{escape(title)}</div>'
            f"{warning}{table(rows)}</div>"
        )
        self._clear.visible = True

    def nothing_there(self) -> None:
        """Say that a click met no surface."""
        self._card.content = paragraph(f"There is no surface. {HOW}", f"color:{BUSY}")
        self._clear.visible = False

    def clear(self) -> None:
        """Show how a place is read."""
        self._card.content = paragraph(HOW, FAINT)
        self._clear.visible = False
