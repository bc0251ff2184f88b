"""A button that sets the terrain's parameters to what explains the points best."""

from collections.abc import Callable
from html import escape

import viser

from app.viewer.host import Host
from app.viewer.widgets.html import BAD, BUSY, table


class FitPanel:
    """Start, progress, cancel, and what came of it; callbacks must only hand on."""

    def __init__(
        self,
        host: Host,
        *,
        on_fit: Callable[[], None],
        on_cancel: Callable[[], None],
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            on_fit: Called when a fit is asked for.
            on_cancel: Called when it is no longer wanted.
        """
        gui = host.gui
        self._fit = gui.add_button(
            "Fit to these submaps",
            hint="Sets length-scale, noise and signal to what explains the points of both submaps "
            "best, by maximum marginal likelihood.",
        )
        self._cancel = gui.add_button("Cancel fit", visible=False, color="red")
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._message = gui.add_html("")

        @self._fit.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            on_fit()

        @self._cancel.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            on_cancel()

    def running(self, fraction: float) -> None:
        """Show how far the fit is."""
        self._set_running(True)
        self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
        self._message.content = _box(escape("Fitting …"), BUSY)

    def stopped(self, message: str = "", *, bad: bool = False) -> None:
        """Show that nothing runs, and why if there is something to say."""
        self._set_running(False)
        self._message.content = _box(escape(message), BAD if bad else BUSY) if message else ""

    def show(self, headline: str, rows: tuple[tuple[str, str], ...]) -> None:
        """Show what was found: a line, and each figure before and after."""
        self._set_running(False)
        self._message.content = _box(f"{escape(headline)}{table(rows)}")

    def _set_running(self, running: bool) -> None:
        self._fit.visible = not running
        self._cancel.visible = running
        self._bar.visible = running


def _box(content: str, color: str = "inherit") -> str:
    return (
        f'<div data-testid="fit" role="status" style="padding:.1em .75em;font-size:.8em;'
        f'color:{color}">{content}</div>'
    )
