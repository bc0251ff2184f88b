"""The modes: explore all submaps, tune a pair, demonstrate it; which panels and scene are shown."""

import threading
from collections.abc import Callable, Mapping
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
"""What a mode shows, and what to do next."""

PANEL_WIDTH = 300
"""As viser's own: a dock that is empty for a moment, as in a change of mode, comes back so wide."""


class Modes(Feature):
    """Shows the panel and the scene of the mode, and gives each page its view of either back."""

    def __init__(self, desk: Desk) -> None:
        """Make the buttons in the current container; until `arrange`, they do nothing."""
        self._desk = desk
        gui = desk.host.gui
        self._buttons = gui.add_button_group("Mode", MODES)  # the guide says what each is for
        self._guide = gui.add_html("")
        on_option(self._buttons, lambda label: self.go(one_of(MODES, label)))
        self._lock = threading.Lock()
        self._views: dict[tuple[Subject, int], Camera] = {}
        self._back_to: Mapping[int, Camera] = {}
        self._scenes: tuple[PairScene, WorldTab] | None = None
        self._panels: Mapping[Mode, viser.PanelHandle] = {}
        self._params: viser.GuiFolderHandle | None = None
        self._show_mode(desk.now.mode)

    def arrange(
        self,
        pair: PairScene,
        world: WorldTab,
        panels: Mapping[Mode, viser.PanelHandle],
        commands: Commands,
        params: viser.GuiFolderHandle,
    ) -> None:
        self._scenes, self._panels, self._params = (pair, world), panels, params
        for panel in panels.values():
            panel.dock_left()
            panel.set_width(PANEL_WIDTH)
        self._show_mode(self._desk.now.mode)
        commands.add(
            "Demo",
            "Full screen, or back",
            lambda: self.set_full_screen(not self._desk.now.full_screen),
            key="F",
        )
        commands.add(
            "Demo",
            "Leave full screen, or A | B",
            self._leave,
            key="escape",
        )
        commands.add("View", "Left panel away, or back", self._put_left_away)

    # Requests.

    def go(self, mode: Mode) -> None:
        """Set the mode; Demo keeps the scene, and Tune has all submaps that came meanwhile."""
        subjects: dict[Mode, Subject] = {"Explore": "world", "Tune": "pair"}
        self._turn(lambda now: replace(now, mode=mode, subject=subjects.get(mode, now.subject)))
        if mode == "Tune":
            self._desk.catch_up()

    def tune(
        self, query_id: str, database_id: str, *, back_to: Mapping[int, Camera] | None = None
    ) -> None:
        """Show a pair in Tune; pages, by number, return to the map as now, or to ``back_to``."""
        self._back_to = back_to or {}
        self._desk.choose(query_id, database_id)
        self.go("Tune")

    def turn_to(self, subject: Subject) -> None:
        self._turn(lambda now: None if now.subject == subject else replace(now, subject=subject))

    def _turn(self, change: Callable[[SessionState], SessionState | None]) -> None:
        """Change the state and what is shown, before anything else; notify the features."""
        if self._scenes is None:
            return
        try:
            with self._lock:
                before = self._desk.now
                self._desk.update(change, deliver=False)
                now = self._desk.now
                if now.mode != before.mode:
                    self._show_mode(now.mode)
                if now.subject != before.subject:
                    self._show_scene(*self._scenes, now)
        finally:
            self._desk.deliver()

    def set_full_screen(self, full_screen: bool) -> None:
        self._put_away(full_screen, self._desk.host.gui.main_panel, *self._panels.values())
        self._desk.update(lambda now: replace(now, full_screen=full_screen, left_away=full_screen))

    def _leave(self) -> None:
        if self._desk.now.full_screen:
            self.set_full_screen(False)
        elif self._desk.now.mode == "Tune":
            self._desk.leave_reference()

    def _put_left_away(self) -> None:
        """Hide or show the panel of the mode; the canvas takes its place."""
        away = not self._desk.now.left_away
        self._put_away(away, *self._panels.values())
        self._desk.update(lambda now: replace(now, left_away=away))

    def _put_away(self, away: bool, *panels: viser.PanelHandle | viser.MainPanelHandle) -> None:
        for panel in panels:  # a person may have put back by hand what is away
            if away:
                panel.minimize()
            else:
                panel.expand()
        self._desk.host.flush()

    # What is shown.

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Forget where cameras were in another dataset; the board takes the left panel's place."""
        if state.view.dataset is not before.view.dataset:
            self._views.clear()
        if state.board not in (before.board, state.left_away):
            self._put_left_away()

    def _show_scene(self, pair: PairScene, world: WorldTab, state: SessionState) -> None:
        """Change the scene; who has moved a camera finds it there when this scene comes back."""
        host, canvases, subject = self._desk.host, self._desk.canvases, state.subject
        before: Subject = "world" if subject == "pair" else "pair"
        clients = pages(host)
        for number, client in clients.items():
            self._views.pop((before, number), None)
            if canvases.is_by_hand(client):
                self._views[before, number] = self._back_to.get(number) or view_of(client)
        self._back_to = {}
        pair.visible = subject == "pair"
        world.open(visible=subject == "world")

        def whole(canvas: Canvas = UNKNOWN_CANVAS) -> Camera | None:
            if subject == "world":
                return world.scene.camera(canvas)
            return pair.camera(state.view, canvas)

        for number, client in clients.items():
            view, everything = self._views.get((subject, number)), whole(canvases.of(client))
            if everything is not None:
                canvases.expect(client, everything)
                set_view(client, view or everything)
        start = whole()
        if start is not None and isinstance(host, viser.ViserServer):
            set_start(host, start)
        host.flush()

    def _show_mode(self, mode: Mode) -> None:
        with self._desk.host.atomic():
            for name, panel in self._panels.items():
                panel.visible = name == mode
            if self._params is not None:
                self._params.visible = mode == "Tune"
            self._guide.content = (
                f"{segment_style(self._buttons, MODES.index(mode))}"
                f'<div data-testid="mode" aria-label="Mode {mode}" style="padding:0 .75em .3em;'
                f'font-size:12px;line-height:1.4;height:2.8em;overflow:hidden;color:{QUIET}">'
                f"{escape(GUIDES[mode])}</div>"
            )
