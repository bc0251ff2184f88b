"""One session: builds the features, and puts them into their panels.

A widget's callback only asks the desk for a change; the desk tells the features, whose jobs draw
what is new. A session is shown on a server, to all of whose pages alike, or on one page; it
never asks which.
"""

from html import escape

import viser

from app.viewer.features.canvas import Framing
from app.viewer.features.chooser import Chooser
from app.viewer.features.data.locating import LocateTool
from app.viewer.features.data.tab import DataTab
from app.viewer.features.demo.tab import DemoTab
from app.viewer.features.desk import Desk
from app.viewer.features.hover import Hover
from app.viewer.features.inspect import InspectTab
from app.viewer.features.links import Links, add_script
from app.viewer.features.modes import Modes
from app.viewer.features.nudge import NudgeTab
from app.viewer.features.pair.compare import CompareTool
from app.viewer.features.pair.tab import PairTab, add_shortcuts
from app.viewer.features.pairs.all_pairs import AllPairsTab
from app.viewer.features.pairs.best_pair import BestPair
from app.viewer.features.pairs.pose_graph import PoseGraphTab
from app.viewer.features.pairs.triage import TriageTab
from app.viewer.features.params.tab import ParamsTab
from app.viewer.features.save.tab import Exports, ReportTool, SaveTab
from app.viewer.features.world import Timeline, WorldTab
from app.viewer.server.host import ALONE, PANEL_WIDTH, Host
from app.viewer.server.limits import READ_ALL, Permissions
from app.viewer.session.jobs import Capacity
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewOptions, ViewState
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import FAINT, add_scripts, button, paragraph
from gpgrad_core.run.memo import Memo


class Session:
    """Panels, scene and jobs of one session, and the features that others ask for."""

    def __init__(  # noqa: PLR0915 - one line a feature
        self,
        host: Host,
        opened: Opened,
        memo: Memo,
        capacity: Capacity,
        permissions: Permissions = READ_ALL,
    ) -> None:
        """Build it on a host and start on the first picture; returns at once.

        Memo and capacity are shared by all sessions: none computes what another has, and they do
        not outnumber the processors. "Reset parameters" goes back to those that are opened.
        """
        desk = self.desk = Desk(
            host, opened.begin(ViewOptions()), memo, capacity, permissions, opened
        )
        explores = opened.drive is not None or (opened.saved or opened).subject == "world"
        commands = Commands(host)
        gui = host.gui
        # The verdict and the parameters are on the right, what is drawn on the left.
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        add_scripts(host)
        modes = desk.join(Modes(desk))
        tune, explore, demo = gui.add_panel(), gui.add_panel(), gui.add_panel()

        # the feature that shows the pair
        self.pair = desk.join(PairTab(desk, opened, tune.add_tab("View")))
        scene = self.pair.scene
        desk.join(CompareTool(desk, scene))
        with explore.add_tab("World"):
            self.world = desk.join(WorldTab(desk, modes, visible=explores))
        framing = desk.join(Framing(desk, scene, self.world))
        self.world.add_rail()
        self._presence = host.gui.add_html("")  # where a phone shows it without scrolling far
        params = desk.join(ParamsTab(desk, opened.params, commands, on_error=self.pair.refuse))
        best_pair = desk.join(BestPair(desk, opened, commands, modes))
        with tune.add_tab("Inspect"):
            self.inspect = desk.join(InspectTab(desk, scene.pick, scene.show_ruler))
            with gui.add_folder("Nudge", expand_by_default=False):
                desk.join(NudgeTab(desk, scene))
        with tune.add_tab("All pairs"):
            best_pair.add_button()
            comparison = desk.join(AllPairsTab(desk, self.world, modes, commands))
            with gui.add_folder("Triage", visible=False) as folder:
                desk.join(TriageTab(desk, commands, folder))
        with tune.add_tab("Data"):
            self.data = desk.join(DataTab(desk, self.pair.refuse))
            desk.join(LocateTool(desk))
        with tune.add_tab("Save"):
            desk.join(SaveTab(desk, self.data.restore))
            desk.join(ReportTool(desk, commands))
            desk.join(Exports(desk, comparison.detection))
            desk.join(Links(desk, commands, modes, framing, self.data.restore))
        with explore.add_tab("Pose graph"):
            self.pose_graph = desk.join(PoseGraphTab(desk, self.world, comparison, modes))
        with demo.add_tab("Demo"):
            show = desk.join(DemoTab(desk, scene, self.world, modes, framing))
        desk.join(Chooser(desk))
        desk.join(Hover(desk, scene, self.world, comparison.light))
        # the feature that plays the drive
        self.timeline = desk.join(Timeline(desk, self.world, modes, opened))
        modes.arrange(
            scene,
            self.world,
            {"Explore": explore, "Tune": tune, "Demo": demo},
            commands,
            params.container,
        )
        add_shortcuts(commands, desk, framing.frame, framing.above, self.inspect.step)
        for feature in (self.world, show, self.timeline):
            feature.add_commands(commands)
        commands.add_buttons()
        add_script(host)  # a page may be there already: what it says is heard by now
        if explores:
            modes.go("Explore")  # before the pair is worked on: the ground comes first
        desk.tell_again()  # with the first picture

    @property
    def state(self) -> ViewState:
        return self.desk.state

    def show_presence(self, together: int, alone: int) -> None:
        """Show how many pages there are; a page joins or leaves by its address."""
        count = together + alone
        if isinstance(self.desk.host, viser.ClientHandle):
            others = {1: "nobody else is", 2: "one more is"}.get(count, f"{count - 1} more are")
            words, act = f"You work alone; {others} here.", "Follow"
            goes = "location.href='./'+location.search"
        else:
            apart = f", {alone} of them alone" if alone else ": all see and change the same"
            words, act = f"{count} people here{apart}.", "Work alone"
            goes = f"location.href='.{ALONE}'+location.search+location.hash"
        line = f"{paragraph(words, FAINT)}{button(act, escape(goes), 'margin:.3em .75em')}"
        is_told = count > 1 or act == "Follow"
        self._presence.content = f'<div data-testid="presence">{line}</div>' if is_told else ""

    def wait_idle(self, timeout: float = 60.0) -> bool:
        """Wait until the picture is up to date; says whether that came true in time [s]."""
        return self.desk.wait_idle(timeout)

    def close(self) -> None:
        self.desk.close()
