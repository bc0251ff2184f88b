"""Exports in the Save tab: wires their panel to the writers of the files."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import viser

from app.viewer.closure_files import write_closure_file
from app.viewer.decisions import Decisions, decide
from app.viewer.downloads import Downloads, safe_name
from app.viewer.draw.cameras import view_of
from app.viewer.draw.overlay import scale_bar
from app.viewer.draw.placement import Canvas
from app.viewer.feature import Desk, Feature, Subject
from app.viewer.methods import METHODS, map_params
from app.viewer.save.exports_panel import ExportPanel
from app.viewer.state import ViewState
from gpgrad_core.errors import InputError
from gpgrad_core.outputs import write_map
from gpgrad_core.pipeline import detect_loop_closures, infer_map
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress
from gpgrad_core.run.threads import num_workers

CLOSURES = {
    "JSON": "closures.json",
    "CSV": "closures.csv",
    "g2o": "graph.g2o",
    "TUM, corrected poses": "poses_corrected.txt",
}
"""File name by what is wanted of the loop closures."""

MAPS = {"NPZ": ".npz", "GeoTIFF": ".tif", "PLY mesh": ".ply", "PNG": ".png"}
"""Ending by the format of a map."""

PICTURE_PIXELS = 1800
"""The larger side of an exported picture is near this: enough for a slide."""
PICTURE_TIMEOUT = 60.0
"""A page without a graphics card draws for seconds [s]."""


class Exports(Feature):
    """Makes the files that pages ask for, of the session as it is when they ask."""

    def __init__(self, desk: Desk) -> None:
        """Make the panel in the current container."""
        self._desk = desk
        self._subject: Subject = "pair"
        self._panel = ExportPanel(
            desk.host,
            closures=tuple(CLOSURES),
            maps=tuple(MAPS),
            on_closures=self._order_closures,
            on_map=self._order_map,
            on_picture=self._order_picture,
        )
        self._downloads = Downloads(self._panel.work_bar, "exports", desk.capacity.long)
        self.workers = (self._downloads,)

    def _order_closures(self, kind: str, page: viser.ClientHandle) -> None:
        write = partial(_write_closures, self._desk.state, self._desk.memo, self._desk.decisions)
        self._downloads.order(page, CLOSURES[kind], write)

    def _order_map(self, kind: str, role: str, page: viser.ClientHandle) -> None:
        state = self._desk.state
        submap_id = state.query_id if role == "query" else state.database_id
        name = f"map_{safe_name(submap_id, role)}{MAPS[kind]}"
        write = partial(_write_map, state, self._desk.memo, submap_id)
        self._downloads.order(page, name, write)

    def turned(self, subject: Subject) -> None:
        """Take that the scene shows the pair or the world."""
        self._subject = subject

    def _order_picture(self, page: viser.ClientHandle) -> None:
        write = partial(_write_picture, self._desk, self._subject, page)
        self._downloads.order(page, "view.png", write)


def _write_closures(
    state: ViewState, memo: Memo, decisions: Decisions, path: Path, progress: Progress
) -> None:
    dataset, params = state.dataset, state.given
    detector = METHODS[state.method].detector
    _ = state.pair  # refuses one submap alone
    with ThreadPoolExecutor(num_workers(), thread_name_prefix="export") as executor:
        result = detect_loop_closures(
            dataset,
            params,
            detector=None if detector is None else detector(params, memo),
            executor=executor,
            memo=memo,
            progress=progress,
        )
    decided = replace(result, closures=decide(result.closures, decisions))
    write_closure_file(path, dataset, decided, params, state.method, decisions=decisions)


def _write_map(
    state: ViewState, memo: Memo, submap_id: str, path: Path, progress: Progress
) -> None:
    submap = state.dataset.submap(submap_id)
    params = map_params(submap, state.given, memo, progress, state.method)
    gradient_map = infer_map(submap, params, memo, progress)
    write_map(path, gradient_map, name=submap_id, max_std_ratio=params.features.max_std_ratio)


def _write_picture(
    desk: Desk, subject: Subject, page: viser.ClientHandle, path: Path, progress: Progress
) -> None:
    """Ask the page for its view of the scene; in a worker's thread, because that takes seconds."""
    from app.viewer.save.picture import Written, draw_picture  # noqa: PLC0415 - loads matplotlib

    progress(0.0)
    camera, canvases = page.camera, desk.canvases
    larger = max(1, round(PICTURE_PIXELS / max(camera.image_width, camera.image_height)))
    width, height = larger * camera.image_width, larger * camera.image_height
    caption = canvases.caption
    written = Written(
        title=f"{desk.state.dataset.name} · {caption.get('title', '')}".removesuffix(" · "),
        line=" · ".join(filter(None, (caption.get("line"), caption.get("frame")))),
        bar=scale_bar(view_of(page), Canvas(width, height)),
        scale=canvases.scales.get(subject),
        dark=desk.state.options.dark,
    )
    try:
        view = page.get_render(
            height=height, width=width, transport_format="png", timeout=PICTURE_TIMEOUT
        )
    except TimeoutError as error:
        raise InputError(
            f"the page sent no picture within {PICTURE_TIMEOUT:.0f} s; bring its window to the "
            "front and try again"
        ) from error
    draw_picture(view, written).savefig(path)
