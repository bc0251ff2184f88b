"""Build submaps of a recording that was chosen, in a new folder that a person names."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from app.viewer.features.data.folders import check_tree, inside
from app.viewer.features.desk import Desk
from app.viewer.features.work import Work
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.html import summary
from app.viewer.widgets.status import WorkBar
from gpgrad_core.errors import InputError, count
from gpgrad_core.io.records.files import check_apart
from gpgrad_core.params import bounds_of
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.run import Progress


@dataclass(frozen=True)
class BuildOrder:
    """What is to be built, where to, and from scans of how much trajectory [m]."""

    scans: Path
    out: Path
    max_length: float


class BuildTool:
    """Appears once a recording was chosen in place of a dataset."""

    def __init__(self, desk: Desk, on_built: Callable[[Path], None]) -> None:
        self._root = desk.permissions.root
        self._on_built = on_built
        self._scans: Path | None = None  # until a recording is offered
        gui = desk.host.gui
        bounds = bounds_of(BuildParams)["max_length"]
        self._folder = gui.add_folder("Build submaps", visible=False)
        with self._folder:
            self._note = gui.add_html("")
            self._length = gui.add_number(
                "Length [m]",
                BuildParams().max_length or bounds.high,
                min=bounds.low,
                max=bounds.high,
                step=bounds.step,
                hint="A submap ends after so much trajectory. gpgrad build has more choices.",
            )
            desk.numbers.add(self._length, bounds, self._set_length)
            self._out = gui.add_text(
                "New folder", "", hint="The dataset to make. It must not exist yet, or be empty."
            )
            start = gui.add_button("Build submaps")
            self.bar = WorkBar(desk.host, "Cancel building", "building", starts=(start,))
        on_press(start, self._start)
        self.work: Work[BuildOrder, tuple[str, ...]] = Work(
            desk.jobs,
            self.bar,
            lambda order: f"Building {order.out.name}",
            self._build,
            self._finish,
            slots=desk.capacity.long,
        )

    def _set_length(self, length: float) -> None:
        self._length.value = length

    def offer(self, scans: Path) -> None:
        self._scans = scans
        self._note.content = summary("recording", (f"{scans.name} is a recording of scans.",))
        self._out.value = str(scans.absolute().with_name(f"{scans.stem}-submaps"))
        self.bar.idle()
        self._folder.visible = True

    def _start(self) -> None:
        out = self._out.value.strip()
        if self._scans is None:
            return
        if not out:
            self.bar.failed("Name the new folder first.")
            return
        self.work.start(BuildOrder(self._scans, Path(out), self._length.value))

    def _build(self, order: BuildOrder, progress: Progress) -> tuple[str, ...]:
        from gpgrad_core.recordings.build import build_dataset  # noqa: PLC0415 - loads slowly
        from gpgrad_core.recordings.recording import RecordingSources  # noqa: PLC0415

        out = self._allowed(order.out)
        if self._root is not None:
            check_tree(self._root, inside(self._root, order.scans))
        check_apart([out], [order.scans])
        params = BuildParams(max_length=order.max_length)
        sources = RecordingSources(root=self._root)
        report = build_dataset(order.scans, out, params, sources=sources, progress=progress)
        made = f"{count(report.num_submaps, 'submap')} of {count(report.num_scans, 'scan')}: {out}"
        return (made, *report.notes)

    def _allowed(self, out: Path) -> Path:
        """The folder to create, without links; with a root, it must lie inside."""
        if self._root is None:
            above = out.expanduser().absolute().parent
            if not above.is_dir():
                raise InputError(f"{above}: there is no such folder to make {out.name} in")
            return above / out.name
        made = inside(self._root, out.parent) / out.name
        return inside(self._root, made) if made.is_symlink() or made.exists() else made

    def _finish(self, order: BuildOrder, lines: tuple[str, ...], _seconds: float) -> None:
        self._folder.visible = False
        self.bar.done(". ".join(lines))
        self._on_built(self._allowed(order.out))
