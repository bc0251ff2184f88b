"""``gpgrad view``: serve the viewer."""

import contextlib
import socket
import warnings
import webbrowser
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from platformdirs import user_config_path
from typing_extensions import Doc

from app.cli.inputs import (
    ALL_PARAMS,
    USERS_CACHE,
    AllParams,
    Cache,
    ParamsFile,
    base_params,
    load,
    open_store,
    resolved,
)
from app.cli.terminal import say, warn
from app.viewer.server.admission import Admission, as_origin, check_token, is_loopback
from app.viewer.server.limits import Permissions
from app.viewer.server.memory import default_budget, read_size, shown
from app.viewer.viewer import Opening, OpeningProgress, Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import MOST_LOADED
from gpgrad_core.io.records.files import check_output
from gpgrad_core.params import read_parameters
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.types import Dataset

if TYPE_CHECKING:  # loaded when they are needed: a page is served before
    from app.viewer.session.session_file import Opened, SavedSession


RECORD = ".gpgrad"
"""Ending of the record of a drive."""


@dataclass(frozen=True)
class Serving:
    """Where the viewer is served, and to whom."""

    host: Annotated[
        str,
        Doc(
            "Address to serve on. With 0.0.0.0, whoever has the link that is printed can use the "
            "viewer."
        ),
    ] = "127.0.0.1"
    port: Annotated[
        int,
        Doc("Port to serve on. If it is taken, the next free one is used. 0 chooses any free one."),
    ] = 8080
    token: Annotated[
        str | None,
        Doc(
            "Whoever opens the viewer must bring this token. The printed link ends with it. At an "
            "address that other machines can reach, each start makes a new one."
        ),
        tyro.conf.arg(metavar="TEXT", help_behavior_hint="(default: made where it is needed)"),
    ] = None
    no_token: Annotated[
        tyro.conf.FlagCreatePairsOff[bool],
        Doc("Ask nobody for a token: whoever can reach the port can use the viewer."),
    ] = False
    allow_origin: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        Doc(
            "Also serve a page of this origin, such as https://viewer.lab.org behind a proxy, or "
            "http://localhost:9000 at the end of a tunnel."
        ),
        tyro.conf.arg(metavar="ORIGIN", help_behavior_hint="(default: none; can be repeated)"),
    ] = ()
    open: Annotated[bool, Doc("Open the browser.")] = True
    memory: Annotated[
        str | None,
        Doc(
            "Memory for the viewer and its helper process together, such as 800MB or 4GB. When it "
            "is passed, results that were kept to be shown again are dropped."
        ),
        tyro.conf.arg(
            metavar="SIZE", help_behavior_hint="(default: a quarter of the machine's, up to 8GB)"
        ),
    ] = None

    def check(self) -> None:
        _check_address(self.host, self.port)
        self._admission()
        if self.memory is not None:
            read_size(self.memory)

    def serve(
        self, opening: Opening, source: str, *, memory: int | None = None, **others: Any
    ) -> None:
        """Serve until interrupted; the other arguments of `Viewer` are those that no flag has."""
        viewer = Viewer(
            opening,
            None,
            self.host,
            self.port,
            source=source,
            admission=self._admission(),
            memory=memory if self.memory is None else read_size(self.memory),
            on_full=warn,
            **others,
        )
        # A page may leave while its picture is drawn: that is no news for the terminal.
        warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
        try:
            say(f"The viewer is at {viewer.link} (Ctrl-C ends)")
            say(f"Memory: up to {shown(viewer.memory)} (--memory changes it)")
            if self.no_token and not is_loopback(self.host):
                warn("no token is asked for: whoever can reach the port can use the viewer")
            if self.open:
                webbrowser.open(viewer.link)
            viewer.run_forever()
        finally:
            viewer.close()

    def _admission(self) -> Admission:
        if self.no_token and self.token is not None:
            raise InputError("--no-token and --token exclude each other")
        return Admission(
            tuple(as_origin(text) for text in self.allow_origin),
            None if self.token is None else check_token(self.token),
            self.no_token,
        )


@dataclass(frozen=True)
class View(Serving):
    """Arguments of ``gpgrad view``."""

    dataset: Annotated[
        tyro.conf.Positional[Path | None],
        Doc("Dataset folder, folder of clouds, one cloud, or a record of gpgrad slam --record."),
        tyro.conf.arg(metavar="[DATASET]", help_behavior_hint="(default: the built-in demo)"),
    ] = None
    sessions: Annotated[
        Literal["shared", "separate"],
        Doc(
            "In a shared session all pages see and change the same, and each may work alone from "
            "there. Separate ones are independent from the start."
        ),
    ] = "shared"
    state: Annotated[
        Path | None,
        Doc(
            "Restore the session that the viewer saved to this file. DATASET and flags override it."
        ),
        tyro.conf.arg(metavar="FILE"),
    ] = None
    root: Annotated[
        Path | None,
        Doc("Pages may open only the datasets in this folder."),
        tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: any folder)"),
    ] = None
    config: Annotated[
        Path | None,
        Doc("Folder of the presets and of the list of recent datasets."),
        tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: the user's own)"),
    ] = None
    cache: Cache = USERS_CACHE
    follow: Annotated[
        str | None,
        Doc(
            "Look at a drive while it goes on. SOURCE is a folder into which submaps or scans are "
            "written, a bag that still grows, - for standard input, or a port (or tcp://HOST:PORT) "
            "for robots that use gpgrad_core.Live."
        ),
        tyro.conf.arg(metavar="SOURCE", help_behavior_hint="(default: none)"),
    ] = None
    record: Annotated[
        Path | None,
        Doc("Keep a drive that is followed in this file. If it exists, the drive goes on with it."),
        tyro.conf.arg(
            metavar="FILE.gpgrad",
            help_behavior_hint="(default: a new file here, if the source cannot be read twice)",
        ),
    ] = None
    track: Annotated[
        Path | None,
        Doc("Write the corrected poses of a drive that is followed to this file (TUM rows)."),
        tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)"),
    ] = None
    max_upload: Annotated[
        int,
        Doc("Size of the largest file that a page may upload, in MB; at most a quarter of memory."),
    ] = 200
    params: ParamsFile = None
    pipeline: AllParams = ALL_PARAMS

    def run(self) -> None:
        self.check()
        if self.root is not None and not self.root.is_dir():
            raise InputError(f"--root {self.root}: there is no such folder")
        if self.max_upload < 1:
            raise InputError(f"--max-upload must be 1 MB or more, got {self.max_upload}")
        if self.follow is not None:
            self._follow(self.follow)
            return
        if self.record is not None or self.track is not None:
            raise InputError("--record and --track go with --follow SOURCE")
        saved = None
        if self.state is not None:
            from app.viewer.session.session_file import read_session  # noqa: PLC0415 - loads slowly

            saved = read_session(self.state)
        source = self.dataset or (saved and saved.dataset) or demo_path()
        if self.params is not None:
            read_parameters(self.params, PipelineParams())  # refused before anything is served
        if not source.exists():
            load(source, most_bytes=MOST_LOADED)  # says so
        self._serve(partial(self._opened, source, saved), str(source), open_store(self.cache))

    def _serve(
        self, opening: Opening, source: str, store: Store | None, memory: int | None = None
    ) -> None:
        permissions = Permissions(
            config=self.config or users_folder(),
            root=self.root,
            max_upload=1_000_000 * self.max_upload,
            writes=is_loopback(self.host) and not self.allow_origin,
        )
        sessions = self.sessions
        self.serve(
            opening, source, memory=memory, sessions=sessions, permissions=permissions, store=store
        )

    def _follow(self, text: str) -> None:
        from app.viewer.session.following import MEMORY, Following  # noqa: PLC0415 - loads slowly
        from gpgrad_core.live.follower import check_track  # noqa: PLC0415
        from gpgrad_core.live.sources import open_source, outlives  # noqa: PLC0415

        if self.dataset is not None or self.state is not None:
            raise InputError("--follow does not go with a DATASET or with --state")
        base = base_params(Dataset("", ()), self.params)
        if self.record is not None:
            check_output(self.record, (RECORD,))
        if self.track is not None:
            check_track(self.track)
        store, source = open_store(self.cache), open_source(text)
        record = self.record
        if record is None and not outlives(text):
            record = Path(f"run-{datetime.now(UTC).astimezone():%Y%m%d-%H%M%S}{RECORD}")
        asked, track = self.pipeline.over(base), self.track
        with contextlib.closing(
            Following(source, asked, say, record=record, track=track, store=store)
        ) as following:
            kept = "" if record is None else f"; --record {record} keeps it and goes on with it"
            say(f"Following {source.name}{kept}")
            self._serve(following.open, source.name, store, min(MEMORY, default_budget()))

    def _opened(
        self, source: Path, saved: "SavedSession | None", memo: Memo, stage: OpeningProgress
    ) -> "Opened":
        from app.viewer.session.session_file import Opened  # noqa: PLC0415 - loads slowly

        run, told = None, stage("Reading the submaps")
        if source.suffix.lower() == RECORD:
            from gpgrad_core.slam import read_run  # noqa: PLC0415 - loads slowly

            run = read_run(source)
            dataset = run.dataset
            warn(*dataset.notes)
        else:
            dataset = load(source, most_bytes=MOST_LOADED, told=told, on_submap=stage.show)
        base = base_params(dataset, None if saved else self.params)
        start = base
        if saved is not None:
            saved.check(dataset)
            start = read_parameters(self.params, saved.params) if self.params else saved.params
        asked = self.pipeline.over(start)
        told = stage("Fitting the automatic parameters to the submaps")
        used = resolved(asked, dataset.submaps, dataset.name, memo, told)
        say(f"{dataset.name} is open")
        if saved is None:
            first = "world" if len(dataset.submaps) > 2 else "pair"
            return Opened(dataset, asked, str(source), None, used, run, first)
        return Opened(dataset, base, str(source), replace(saved, params=asked), used)


def users_folder() -> Path | None:
    """Find the user's own folder for settings; None if the user has no home."""
    try:
        return user_config_path("gpgrad", appauthor=False)
    except RuntimeError:
        return None


def _check_address(host: str, port: int) -> None:
    """Refuse an address that cannot be served: the server would wait for itself for ever."""
    if not 0 <= port <= 65535:
        raise InputError(f"--port must be from 0 to 65535, got {port}")
    try:
        family, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family) as probe:
            probe.bind(address)
    except OSError as error:
        raise InputError(f"--host {host}: cannot serve there: {error.strerror}") from error
