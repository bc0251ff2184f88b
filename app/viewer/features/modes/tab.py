"""The modes: wires their buttons to the panels and the two scenes."""

import threading
from collections.abc import Mapping

import viser

from app.viewer.features.desk import Desk, Feature, Mode, Subject
from app.viewer.features.modes.panel import ModesPanel
from app.viewer.features.pair import PairScene
from app.viewer.features.world import WorldTab
from app.viewer.scene.cameras import set_start, set_view, view_of
from app.viewer.scene.placement import UNKNOWN_CANVAS, Canvas
from app.viewer.server.host import pages
from app.viewer.session.state import Camera, ViewState
from app.viewer.widgets.commands import Commands

PANEL_WIDTH = 320


class Modes(Feature):
    """Changes between the pair and the world, and gives each page its view of either back."""

    def __init__(self, desk: Desk) -> None:
        """Make the buttons in the current container, and begin with the pair.

        Until `arrange`, they do nothing.
        """
        self._desk = desk
        self._mode: Mode = "Tune"
        self._panel = ModesPanel(desk.host, self._mode, self.go)
        self._lock = threading.Lock()
        self._state = desk.state
        self._full_screen = False
        self._views: dict[tuple[Subject, int], Camera] = {}
        self._scenes: tuple[PairScene, WorldTab] | None = None
        self._panels: Mapping[Mode, viser.PanelHandle] = {}

    def arrange(
        self,
        pair: PairScene,
        world: WorldTab,
        panels: Mapping[Mode, viser.PanelHandle],
        commands: Commands,
    ) -> None:
        """Take over the scenes, and the panels, of which one at a time is to be seen."""
        self._scenes = pair, world
        self._panels = panels
        for panel in panels.values():
            panel.dock_left()
            panel.set_width(PANEL_WIDTH)
        self._show_panels()
        commands.add(
            "Demo",
            "Full screen, or back",
            lambda: self.set_full_screen(not self._full_screen),
            key="F",
        )
        commands.add("Demo", "Leave full screen", self._leave_full_screen, key="escape")

    def follow(self, state: ViewState) -> None:
        """Follow the session: where the cameras were says nothing about another dataset."""
        if state.dataset is not self._state.dataset:
            self._views.clear()
        self._state = state

    def tune(self, query_id: str, database_id: str) -> None:
        """Show a pair in the mode in which it is tuned."""
        self._desk.choose(query_id, database_id)
        self.go("Tune")

    def go(self, mode: Mode) -> None:
        """Go to a mode; Demo keeps what is to be seen."""
        self._mode = mode
        self._show_panels()
        if mode != "Demo":
            self.turn_to("world" if mode == "Explore" else "pair")
        self._panel.show(mode)

    def turn_to(self, subject: Subject) -> None:
        """Show the pair or the world."""
        if self._scenes is None:
            return
        pair, world = self._scenes
        host = self._desk.host
        with self._lock:
            before: Subject = "world" if world.scene.visible else "pair"
            if subject == before:
                return
            clients = pages(host)
            canvases = self._desk.canvases
            for number, client in clients.items():
                self._views.pop((before, number), None)
                if canvases.is_by_hand(client):
                    self._views[before, number] = view_of(client)
            pair.visible = subject == "pair"
            world.open(visible=subject == "world")

            def whole(canvas: Canvas = UNKNOWN_CANVAS) -> Camera | None:
                if subject == "world":
                    return world.camera(canvas)
                return pair.camera(self._state, canvas)

            for number, client in clients.items():
                view, all_of_it = self._views.get((subject, number)), whole(canvases.of(client))
                if all_of_it is not None:
                    canvases.expect(client, all_of_it)
                    set_view(client, view or all_of_it)
            start = whole()
            if start is not None and isinstance(host, viser.ViserServer):
                set_start(host, start)
        self._desk.tell(lambda feature: feature.turned(subject))
        host.flush()

    def set_full_screen(self, full_screen: bool) -> None:
        """Put the panels away, or back."""
        self._full_screen = full_screen
        for panel in (self._desk.host.gui.main_panel, *self._panels.values()):
            if full_screen:
                panel.minimize()
            else:
                panel.expand()
        self._desk.host.flush()
        self._desk.tell(lambda feature: feature.resized())

    def _leave_full_screen(self) -> None:
        if self._full_screen:
            self.set_full_screen(False)

    def _show_panels(self) -> None:
        with self._desk.host.atomic():
            for mode, panel in self._panels.items():
                panel.visible = mode == self._mode
