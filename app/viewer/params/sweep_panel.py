"""A folder that shows what one parameter does to the verdict on the pair that is shown."""

from collections.abc import Callable

from app.viewer.host import Host
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.work_bar import WorkBar


class SweepPanel:
    """A list of parameters, a button, and the picture."""

    def __init__(
        self,
        host: Host,
        names: tuple[str, ...],
        on_sweep: Callable[[], None],
        on_name: Callable[[], None],
    ) -> None:
        """Make the widgets in the current container; callbacks must only hand on.

        Args:
            host: Whose GUI they join.
            names: Of the parameters.
            on_sweep: Called when a sweep is asked for.
            on_name: Called when another parameter is chosen.
        """
        with host.gui.add_folder("Sensitivity", expand_by_default=False):
            self._name = host.gui.add_dropdown(
                "Of", names, initial_value=names[0], hint="The parameter that is varied."
            )
            sweep = host.gui.add_button(
                "Sweep",
                hint="Registers this pair at values over the whole slider, and draws score and "
                "inliers. The other parameters stay as they are.",
            )
            self.work_bar = WorkBar(host, "Cancel sweep", "sweep", starts=(sweep,))
            self._picture = host.gui.add_html("")
        on_press(sweep, on_sweep)
        on_choice(self._name, lambda _: on_name())

    @property
    def name(self) -> str:
        """The chosen parameter."""
        return self._name.value

    def show(self, content: str) -> None:
        """Show the picture; it is sent only if it is another."""
        if self._picture.content != content:
            self._picture.content = content
