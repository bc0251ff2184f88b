"""The modes: explore all submaps, tune a pair, demonstrate it; which panels and scene are seen."""

import threading
from collections.abc import Mapping
from dataclasses import replace
from html import escape
from typing import get_args

import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.pair import PairScene
from app.viewer.features.world import WorldTab
from app.viewer.scene.cameras import set_start, set_view, view_of
from app.viewer.scene.placement import UNKNOWN_CANVAS, Canvas
from app.viewer.server.host import pages
from app.viewer.session.news import Mode, SessionState, Subject
from app.viewer.session.state import Camera
from app.viewer.widgets.actions import on_option, one_of
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import QUIET, segment_style

MODES: tuple[Mode, ...] = get_args(Mode)
GUIDES: dict[Mode, str] = {
    "Explore": "All submaps as one map. Click a place for what is known there. The tab Pose graph "
    "corrects the map.",
    "Tune": "Do the two submaps show the same place? Drag a slider: surfaces and verdict follow.",
    "Demo": "Show it to others with saved views, motion and full screen, or save it as a page.",
}
"""What is to be seen in a mode, and what to do next."""


PANEL_WIDTH = 280


class Modes(Feature):
    """Changes between the pair and the world, and gives each page its view of either back."""

    def __init__(self, desk: Desk) -> None:
        """Make the buttons in the current container, and begin with the pair.

        Until `arrange`, they do nothing.
        """
        self._desk = desk
        gui = desk.host.gui
        self._buttons = gui.add_button_group("Mode", MODES)  # the guide says what each is for
        self._guide = gui.add_html("")
        self._show_mode()
        on_option(self._buttons, lambda label: self.go(one_of(MODES, label)))
        self._lock = threading.Lock()
        self._views: dict[tuple[Subject, int], Camera] = {}
        self._scenes: tuple[PairScene, WorldTab] | None = None
        self._panels: Mapping[Mode, viser.PanelHandle] = {}
        self._params: viser.GuiFolderHandle | None = None

    def arrange(
        self,
        pair: PairScene,
        world: WorldTab,
        panels: Mapping[Mode, viser.PanelHandle],
        commands: Commands,
        params: viser.GuiFolderHandle,
    ) -> None:
        """Take over the scenes, the panels, of which one at a time is to be seen, and the sliders.

        The sliders are seen in Tune alone.
        """
        self._params = params
        self._scenes = pair, world
        self._panels = panels
        for panel in panels.values():
            panel.dock_left()
            panel.set_width(PANEL_WIDTH)
        self._show_panels()
        commands.add(
            "Demo",
            "Full screen, or back",
            lambda: self.set_full_screen(not self._desk.now.full_screen),
            key="F",
        )
        commands.add(
            "Demo",
            "Leave full screen",
            lambda: self.set_full_screen(False) if self._desk.now.full_screen else None,
            key="escape",
        )
        commands.add("View", "Left panel away, or back", self._put_left_away)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Forget where the cameras were, which says nothing about another dataset."""
        if state.view.dataset is not before.view.dataset:
            self._views.clear()

    def tune(self, query_id: str, database_id: str) -> None:
        """Show a pair in the mode in which it is tuned."""
        self._desk.choose(query_id, database_id)
        self.go("Tune")

    def go(self, mode: Mode) -> None:
        """Go to a mode; Demo keeps what is to be seen.

        Tune can choose any pair of a drive that goes on, and knows all that has come.
        """
        with self._lock:
            self._desk.update(lambda now: replace(now, mode=mode), deliver=False)
            self._show_panels()
        self._show_mode()
        self._desk.deliver()
        if mode != "Demo":
            self.turn_to("world" if mode == "Explore" else "pair")
        if mode == "Tune":
            self._desk.catch_up()

    def turn_to(self, subject: Subject) -> None:
        """Show the pair or the world."""
        if self._scenes is None:
            return
        pair, world = self._scenes
        host = self._desk.host
        with self._lock:
            before = self._desk.now.subject
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
                    return world.scene.camera(canvas)
                return pair.camera(self._desk.state, canvas)

            for number, client in clients.items():
                view, everything = self._views.get((subject, number)), whole(canvases.of(client))
                if everything is not None:
                    canvases.expect(client, everything)
                    set_view(client, view or everything)
            start = whole()
            if start is not None and isinstance(host, viser.ViserServer):
                set_start(host, start)
            self._desk.update(lambda now: replace(now, subject=subject), deliver=False)
        self._desk.deliver()
        host.flush()

    def set_full_screen(self, full_screen: bool) -> None:
        """Put the panels away, or back."""
        self._put_away(full_screen, self._desk.host.gui.main_panel, *self._panels.values())
        self._desk.update(lambda now: replace(now, full_screen=full_screen, left_away=full_screen))

    def _put_left_away(self) -> None:
        """Put the panel of the mode away, or back; the canvas takes its place."""
        away = not self._desk.now.left_away
        self._put_away(away, *self._panels.values())
        self._desk.update(lambda now: replace(now, left_away=away))

    def _put_away(self, away: bool, *panels: viser.PanelHandle | viser.MainPanelHandle) -> None:
        for panel in panels:
            if away:
                panel.minimize()
            else:
                panel.expand()
        self._desk.host.flush()

    def _show_mode(self) -> None:
        mode = self._desk.now.mode
        self._guide.content = (
            f"{segment_style(self._buttons, MODES.index(mode))}"
            f'<div data-testid="mode" aria-label="Mode {mode}" style="padding:0 .75em .3em;'
            f'font-size:12px;line-height:1.4;height:2.8em;overflow:hidden;color:{QUIET}">'
            f"{escape(GUIDES[mode])}</div>"
        )

    def _show_panels(self) -> None:
        now = self._desk.now.mode
        with self._desk.host.atomic():
            for mode, panel in self._panels.items():
                panel.visible = mode == now
            if self._params is not None:
                self._params.visible = now == "Tune"
