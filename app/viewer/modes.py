"""Which scene is to be seen and which panels beside it: the three ways of use."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import viser

from app.viewer.capacity import Turns
from app.viewer.demo.panel import Subject
from app.viewer.demo.tab import Demo
from app.viewer.draw.cameras import set_start, set_view, view_of
from app.viewer.draw.placement import Camera
from app.viewer.feature import Part
from app.viewer.host import Host, pages
from app.viewer.pair.scene import PairScene
from app.viewer.pose_graph.tab import PoseGraph
from app.viewer.state import ViewState
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.modes import Way, WaysPanel
from app.viewer.world.tab import Explore
from gpgrad_core.run.memo import Memo

VIEW_WIDTH = 320


@dataclass(frozen=True)
class StageCalls:
    """What the stage asks of the session; all must be quick.

    Attributes:
        on_tune: Given the query and the database to show in Tune.
        on_registered: Called when the pair is to be shown registered.
        on_find: Called when all pairs are to be compared.
        on_cancel_find: Called when they no longer are.
        message_of: Says what went wrong in one line.
    """

    on_tune: Callable[[str, str], None]
    on_registered: Callable[[], None]
    on_find: Callable[[], None]
    on_cancel_find: Callable[[], None]
    message_of: Callable[[Exception], str]


class Stage(Part):
    """Changes between the pair and the world, and gives each page its view of either back."""

    def __init__(
        self,
        host: Host,
        state: ViewState,
        memo: Memo,
        turns: Turns,
        pair: PairScene,
        tune_panel: viser.PanelHandle,
        ways: WaysPanel,
        commands: Commands,
        calls: StageCalls,
    ) -> None:
        """Make the panels of the other ways beside Tune's, and begin with that and the pair.

        Args:
            host: Whose panels and scene are changed.
            state: The session as it is.
            memo: Shared with the pair that is shown.
            turns: Held while something is computed.
            pair: Scene of the pair.
            tune_panel: Panel of Tune.
            ways: Says which way it is.
            commands: Get those for the full screen.
            calls: What is asked of the session.
        """
        self._host = host
        self._pair = pair
        self._ways = ways
        self._state = state
        self._lock = threading.Lock()
        self._way: Way = "Tune"
        self._full_screen = False
        self._views: dict[tuple[Subject, int], Camera] = {}

        def tune(query_id: str, database_id: str) -> None:
            calls.on_tune(query_id, database_id)
            self.go("Tune")

        explore_panel, demo_panel = host.gui.add_panel(), host.gui.add_panel()
        with explore_panel.add_tab("World"):
            self._explore = Explore(
                host, state, memo, turns, on_tune=tune, message_of=calls.message_of
            )
        with explore_panel.add_tab("Pose graph"):
            self.graph = PoseGraph(
                host,
                state,
                turns,
                self._explore,
                on_find=calls.on_find,
                on_cancel_find=calls.on_cancel_find,
                on_tune=tune,
                message_of=calls.message_of,
            )
        with demo_panel.add_tab("Demo"):
            demo = Demo(
                host,
                state,
                turns,
                pair,
                self._explore,
                on_subject=self.turn_to,
                on_registered=calls.on_registered,
                on_full_screen=lambda: self.set_full_screen(True),
                message_of=calls.message_of,
            )
        self.parts: tuple[Part, ...] = (self._explore, self.graph, demo)
        self._panels: dict[Way, viser.PanelHandle] = {
            "Explore": explore_panel,
            "Tune": tune_panel,
            "Demo": demo_panel,
        }
        for panel in self._panels.values():  # one at a time is to be seen
            panel.dock_left()
            panel.set_width(VIEW_WIDTH)
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

    def follow(self, state: ViewState) -> None:
        """Follow the session: where the cameras were says nothing about another dataset."""
        if state.dataset is not self._state.dataset:
            self._views.clear()
        self._state = state

    def go(self, way: Way) -> None:
        """Go over to a way of use; Demo keeps what is to be seen."""
        self._way = way
        self._show_panels()
        if way != "Demo":
            self.turn_to("world" if way == "Explore" else "pair")
        self._ways.show(way)

    def turn_to(self, subject: Subject) -> None:
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
            whole = self._explore.camera() if subject == "world" else self._pair.camera(self._state)
            for number, client in clients.items():
                view = self._views.get((subject, number), whole)
                if view is not None:
                    set_view(client, view)
            if whole is not None and isinstance(self._host, viser.ViserServer):
                set_start(self._host, whole)
        self._host.flush()

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
