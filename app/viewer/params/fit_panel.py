"""A button that sets the terrain's parameters to the values that explain the points best."""

from collections.abc import Callable
from html import escape

from app.viewer.host import Host
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.html import box, table
from app.viewer.widgets.look import make_solid
from app.viewer.widgets.work_bar import WorkBar


class FitPanel:
    """Starts a fit, and shows how far it is and what it found."""

    def __init__(self, host: Host, on_fit: Callable[[], None]) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            on_fit: Called when a fit is asked for.
        """
        self._fit = fit = host.gui.add_button(
            "Fit to these submaps",
            hint="Sets length-scale, noise and signal to the values that explain the points of "
            "both submaps best, by maximum marginal likelihood.",
        )
        make_solid(host, fit)
        self.work_bar = WorkBar(host, "Cancel fit", "fit", starts=(fit,))
        on_press(fit, on_fit)

    def show_button(self, *, visible: bool) -> None:
        """Show the button, or hide it where every submap has a fit of its own."""
        self._fit.visible = visible

    def show(self, headline: str, rows: tuple[tuple[str, str], ...]) -> None:
        """Show what was found: a line, and each figure before and after."""
        self.work_bar.show(box("fit", f"{escape(headline)}{table(rows)}", "font-size:.8em"))
