"""The Data tab: opens another dataset, a recent one, by its path, from a folder, or an upload."""

import os
import shutil
import tempfile
from collections.abc import Callable, Generator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path, PurePath
from typing import Annotated

import viser
from msgspec import Meta, Struct

from app.recordings import built_first
from app.viewer.features.data.building import BuildTool
from app.viewer.features.data.folders import (
    Listing,
    check_inside,
    check_tree,
    list_folder,
    recent_datasets,
    remember_dataset,
)
from app.viewer.features.data.unpacking import (
    KNOWN,
    MOST_FILES,
    MOST_GROWTH,
    PACKED,
    check_cloud,
    unpack,
)
from app.viewer.features.desk import Desk, Feature
from app.viewer.features.work import CANCELLED, Work
from app.viewer.session.session_file import Opened, SavedSession
from app.viewer.widgets.actions import on_choice, on_option, on_press, on_upload
from app.viewer.widgets.bridge import Whole, page_script
from app.viewer.widgets.html import uuid_of
from app.viewer.widgets.status import WorkBar
from gpgrad_core.detection import PipelineParams, resolve_parameters
from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds import CLOUD_ENDINGS
from gpgrad_core.io.folder import MOST_LOADED, load_dataset
from gpgrad_core.params import preferred_parameters
from gpgrad_core.reading.paths import check_name
from gpgrad_core.run import Progress, part
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.slam import read_run
from gpgrad_core.slam.run_file import ENDING as RECORD

NO_RECENT: str = "—"
UP: str = "↑ up"
CHOOSE: str = "choose …"
CLOUDS = "uploaded clouds"
"""Name of the dataset that single clouds gather in."""


class NotDropped(Struct):
    """What a page says of something that it was to open and did not send."""

    name: str
    files: Whole
    bytes: Annotated[float, Meta(ge=0)]


@dataclass(frozen=True)
class Request:
    """What to open: a path, what a page has uploaded, or else the demo."""

    path: Path | None = None
    upload: tuple[str, bytes] | None = None
    saved: SavedSession | None = None

    @property
    def name(self) -> str:
        if self.upload is not None:
            return self.upload[0].removesuffix(PACKED)
        return "the demo" if self.path is None else str(self.path)


class DataTab(Feature):
    """Opens one dataset at a time; what is open stays until the next is ready."""

    def __init__(self, desk: Desk, on_error: Callable[[str], None] = lambda _: None) -> None:
        """Add the widgets to the current container; an error is reported outside of it, too."""
        self._desk, self._on_error = desk, on_error
        allowed = self._permissions = desk.permissions
        self._uploads: Path | None = None  # of this session, created when first needed
        self._folder = Path()
        gui, browses = desk.host.gui, allowed.root is not None
        self._recent: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Recent",
            (NO_RECENT,),
            initial_value=NO_RECENT,
            hint="Open a dataset that was open before.",
        )
        self._path = gui.add_text(
            "Folder",
            desk.state.source,
            hint="A dataset folder, a folder of clouds, or one cloud, "
            "on the machine that runs the viewer.",
        )
        buttons = gui.add_button_group(
            "Open", ("Load", "Load demo"), hint="Load the folder above, or the built-in demo."
        )
        self.place = gui.add_html("", visible=browses)
        self._entries: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Browse",
            (CHOOSE,),
            initial_value=CHOOSE,
            visible=browses,
            hint="Enter a folder on the machine that runs the viewer, or choose a cloud.",
        )
        self._here = gui.add_button("Use this folder", visible=False)
        upload = gui.add_upload_button(
            "Upload clouds or a .zip",
            visible=allowed.uploads is not None,
            hint="A zipped dataset, or a cloud. Further clouds join the ones that you uploaded "
            f"before. Up to {allowed.max_upload / 1e6:,.0f} MB.",
        )
        self.work_bar = WorkBar(desk.host, "Cancel loading", "dataset")
        self._loader: Work[Request, Opened] = Work(
            desk.jobs,
            self.work_bar,
            lambda request: f"Loading {request.name}",
            self._load,
            self._on_loaded,
            watch=self._watch,
        )
        on_option(
            buttons,
            lambda label: (
                self._loader.start(Request())
                if label == "Load demo"
                else self.open(self._path.value.strip())
            ),
        )
        on_choice(self._recent, lambda path: None if path == NO_RECENT else self.open(path))
        on_press(self._here, lambda: self._loader.start(Request(self._folder)))
        self._show_recent()
        self._builder = None
        if allowed.writes:
            self._builder = BuildTool(desk, lambda folder: self._loader.start(Request(folder)))
        if allowed.uploads is not None:
            on_upload(
                upload,
                lambda name, content: self._upload(PurePath(name.replace("\\", "/")).name, content),
            )
            self._take_drops()
        if browses:
            on_choice(self._entries, self._enter)
            self._list()

    def restore(self, saved: SavedSession) -> None:
        self._loader.start(Request(saved.dataset, saved=saved))

    def _watch(self, fraction: float | None, message: str) -> None:
        """Report an error where the picture is, as the tab may not be visible."""
        if fraction is None and message not in ("", CANCELLED):
            self._on_error(message)

    def _take_drops(self) -> None:
        """Open what is dropped anywhere on a page; it comes by an upload button that is unseen."""
        gui, bridge = self._desk.host.gui, self._desk.bridge
        with bridge.folder:
            button = gui.add_upload_button("drop")
            script = page_script(
                "drop.js",
                BUTTON=uuid_of(button),
                KNOWN=sorted(KNOWN),
                PACKED=PACKED,
                MOST_FILES=MOST_FILES,
                MOST_BYTES=self._permissions.max_upload,
            )
            gui.add_html(script)
        on_upload(button, self._upload)
        bridge.on_message("not dropped", NotDropped, self._refuse_drop)

    def _refuse_drop(self, _page: viser.ClientHandle, said: NotDropped) -> None:
        most = self._permissions.max_upload
        if said.bytes > most:
            why = f"has {said.bytes / 1e6:,.0f} MB; up to {most / 1e6:,.0f} MB can be dropped"
        elif said.files > MOST_FILES:
            why = f"holds more than {MOST_FILES:,} files"
        elif said.files and not said.bytes:
            why = f"is neither a folder, a zipped dataset (.zip) nor a cloud ({CLOUD_ENDINGS})"
        else:
            why = "could not be read, or the panels are put away; bring them back with Esc"
        self.refuse(f"{said.name[:80]}: {why}")

    def refuse(self, message: str) -> None:
        self.work_bar.failed(message)
        self._on_error(message)

    def close(self) -> None:
        if self._uploads is not None:
            shutil.rmtree(self._uploads, ignore_errors=True)

    # What the panel asks for.

    def open(self, path: str) -> None:
        if not path:
            self.work_bar.failed("Type the path of a dataset folder first.")
            return
        try:
            self._loader.start(Request(Path(path).expanduser()))
        except RuntimeError:  # "~nobody", or "~" of a user without a home
            self.work_bar.failed(f"{Path(path).parts[0]}: there is no such home folder.")

    def _upload(self, name: str, content: bytes) -> None:
        try:
            name = check_name(name).name  # a page may send any name, and files get it
        except InputError as error:
            self.refuse(f"The upload was refused: {error}")
            return
        self._loader.start(Request(upload=(name, content)))

    def _enter(self, name: str) -> None:
        if name == CHOOSE:
            return
        chosen = self._folder.parent if name == UP else self._folder / name.rstrip("/")
        if name != UP and not name.endswith("/"):
            self._loader.start(Request(chosen))
            return
        self._folder = chosen
        self._list()

    def _list(self) -> None:
        root = self._permissions.root
        assert root is not None
        try:
            listing = list_folder(root, self._folder)
        except InputError as error:
            self._folder = Path()
            self.work_bar.failed(str(error))
            return
        self.place.content = place_html(root, listing)
        up = () if listing.folder == Path() else (UP,)
        self._entries.options = (CHOOSE, *up, *listing.entries)
        self._entries.value = CHOOSE
        self._here.visible = listing.is_dataset

    def _show_recent(self, opened: str = "") -> None:
        config = self._permissions.config
        if config is not None:
            recent = remember_dataset(config, opened) if opened else recent_datasets(config)
            self._recent.options = (NO_RECENT, *recent)
            self._recent.value = NO_RECENT

    # What the loader does.

    def _load(self, request: Request, progress: Progress) -> Opened:
        progress(0.0)
        notes: tuple[str, ...] = ()
        loading = progress
        if request.upload is not None:
            source, notes = self._unpacked(*request.upload, part(progress, 0.0, 0.5))
            loading = part(progress, 0.5, 1.0)
        elif request.path is not None and self._permissions.root is not None:
            source = check_inside(self._permissions.root, request.path)
        else:
            source = request.path or demo_path()
        try:
            # What was uploaded lies in a temporary folder, where nobody can build from it.
            with self._recording(source) if request.upload is None else nullcontext():
                run = read_run(source) if source.suffix.lower() == RECORD else None
                dataset = (
                    load_dataset(source, loading, most_bytes=MOST_LOADED)
                    if run is None
                    else run.dataset
                )
        except BaseException as error:
            self._forget(request, source)
            if request.upload is None or not isinstance(error, InputError | OSError):
                raise
            raise InputError(_as_uploaded(error, request.name, source)) from error
        dataset = replace(dataset, notes=(*notes, *dataset.notes))
        if request.saved is not None:
            request.saved.check(dataset)
        params = preferred_parameters(dataset, PipelineParams())
        used = resolve_parameters(dataset.submaps, params, self._desk.memo)
        return Opened(dataset, params, str(source), request.saved, used, run)

    @contextmanager
    def _recording(self, source: Path) -> Generator[None]:
        """Offer to build submaps from a recording, or explain how to if none may be built."""
        if self._builder is None:
            with built_first(source):
                yield
            return
        try:
            yield
        except InputError as error:
            from gpgrad_core.recordings.build import is_recording  # noqa: PLC0415 - loads slowly

            if not is_recording(source):
                raise
            if self._permissions.root is not None:
                check_tree(self._permissions.root, source)
            self._builder.offer(source)
            raise InputError(
                f"{source.name}: is a recording; build its submaps in the tab Data"
            ) from error

    def _unpacked(
        self, name: str, content: bytes, progress: Progress
    ) -> tuple[Path, tuple[str, ...]]:
        if self._uploads is None:
            assert self._permissions.uploads is not None
            self._uploads = Path(tempfile.mkdtemp(dir=self._permissions.uploads))
        most = MOST_GROWTH * self._permissions.max_upload
        if name.lower().endswith((".zip", PACKED)):
            folder = Path(tempfile.mkdtemp(dir=self._uploads)) / (Path(name).stem or "dataset")
            return unpack(name, content, folder, most, progress)
        folder = self._uploads / CLOUDS
        folder.mkdir(exist_ok=True)
        cloud = folder / name
        if cloud.exists():
            raise InputError(f"{name}: was uploaded before; rename one of them")
        if len(content) + sum(file.stat().st_size for file in folder.iterdir()) > most:
            raise InputError(
                f"{name}: the uploaded clouds would have more than {most / 1e6:,.0f} MB together; "
                "open another dataset to begin anew"
            )
        cloud.write_bytes(content)
        try:
            check_cloud(cloud, most)
        except InputError:
            cloud.unlink()
            raise
        return folder, ()

    def _forget(self, request: Request, source: Path) -> None:
        if request.upload is None:
            return
        if source.name == CLOUDS:
            (source / request.upload[0]).unlink(missing_ok=True)
        elif self._uploads is not None and source.is_relative_to(self._uploads):
            top = self._uploads / source.relative_to(self._uploads).parts[0]
            shutil.rmtree(top, ignore_errors=True)

    def _on_loaded(self, request: Request, opened: Opened, _seconds: float) -> None:
        self._desk.open(opened)
        self._path.value = opened.source
        if request.path is not None:
            self._show_recent(str(Path(opened.source).absolute()))
        if self._uploads is not None:  # what is no longer open
            for old in self._uploads.iterdir():
                if not Path(opened.source).is_relative_to(old):
                    shutil.rmtree(old, ignore_errors=True)


def place_html(root: Path, listing: Listing) -> str:
    """Write which folder is listed, and how much of it is not."""
    note = ""
    if listing.num_hidden:
        note = f"<br>{listing.num_hidden:,} more are not listed; type the path"
    return (
        '<div data-testid="place" style="padding:0 .75em;font-size:.85em;overflow-wrap:anywhere">'
        f"{escape(str(root / listing.folder))}{note}</div>"
    )


def _as_uploaded(error: Exception, name: str, source: Path) -> str:
    """What is wrong with an upload, by the names that the page has, not by where it lies."""
    if isinstance(error, OSError):
        return f"{name}: {error.strerror or error}"
    within, shown = "" if source.name == CLOUDS else f"{name}: ", InputError(source)  # as errors do
    return str(error).replace(f"{shown}{os.sep}", within).replace(str(shown), name)
