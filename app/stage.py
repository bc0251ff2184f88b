"""Which scene is to be seen and which panels beside it: the three ways of use."""

import threading
from collections.abc import Mapping

import viser

from app.explore import Explore
from app.host import Host, pages
from app.panels.commands import Commands
from app.panels.demo import Subject
from app.panels.ways import Way, WaysPanel
from app.state import ViewState
from app.views.flight import set_start, set_view, view_of
from app.views.placement import Camera
from app.views.scene import PairScene


class Stage:
    """Changes between the pair and the world, and gives each page its view of either back."""

    def __init__(
        self,
        host: Host,
        pair: PairScene,
        explore: Explore,
        panels: Mapping[Way, viser.PanelHandle],
        ways: WaysPanel,
        commands: Commands,
    ) -> None:
        """Begin with Tune and the pair.

        Args:
            host: Whose panels and scene are changed.
            pair: Scene of the pair.
            explore: The world.
            panels: Of each way; the others are put away.
            ways: Says which way it is.
            commands: Get those for the full screen.
        """
        self._host = host
        self._pair = pair
        self._explore = explore
        self._panels = panels
        self._ways = ways
        self._lock = threading.Lock()
        self._way: Way = "Tune"
        self._full_screen = False
        self._views: dict[tuple[Subject, int], Camera] = {}
        self._show_panels()
        commands.add(
            "Demo",
            "Full screen, or back",
            lambda client: self.set_full_screen(not self._full_screen),  # noqa: ARG005
            key="F",
        )
        commands.add(
            "Demo",
            "Leave full screen",
            lambda client: self._leave_full_screen(),  # noqa: ARG005
            key="escape",
        )

    @property
    def subject(self) -> Subject:
        """What is to be seen."""
        return "world" if self._explore.scene.visible else "pair"

    def go(self, way: Way, state: ViewState) -> None:
        """Go over to a way of use; Demo keeps what is to be seen."""
        self._way = way
        self._show_panels()
        if way != "Demo":
            self.show("world" if way == "Explore" else "pair", state)
        self._ways.show(way)

    def show(self, subject: Subject, state: ViewState) -> None:
        """Show the pair or the world."""
        with self._lock:
            before = self.subject
            if subject == before:
                return
            clients = pages(self._host)
            for number, client in clients.items():
                self._views[before, number] = view_of(client)
            self._pair.visible = subject == "pair"
            self._explore.open(visible=subject == "world")
            whole = self._explore.camera() if subject == "world" else self._pair.camera(state)
            for number, client in clients.items():
                view = self._views.get((subject, number), whole)
                if view is not None:
                    set_view(client, view)
            if whole is not None and isinstance(self._host, viser.ViserServer):
                set_start(self._host, whole)
        self._host.flush()

    def forget_views(self) -> None:
        """Forget where the cameras were: another dataset is shown."""
        with self._lock:
            self._views.clear()

    def set_full_screen(self, full_screen: bool) -> None:
        """Put the panels away, or back."""
        self._full_screen = full_screen
        for panel in (self._host.gui.main_panel, *self._panels.values()):
            if full_screen:
                panel.minimize()
            else:
                panel.expand()
        self._host.flush()

    def _leave_full_screen(self) -> None:
        if self._full_screen:
            self.set_full_screen(False)

    def _show_panels(self) -> None:
        with self._host.atomic():
            for way, panel in self._panels.items():
                panel.visible = way == self._way
