"""Exports from the browser: wires their panel to a runner, and the runner to the files' writers."""

import re
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import viser

from app.viewer.feature import Part
from app.viewer.host import Host
from app.viewer.runner import Runner
from app.viewer.save.exports_panel import ExportPanel
from app.viewer.state import ViewState
from gpgrad_core.datasets.poses import write_poses
from gpgrad_core.errors import InputError
from gpgrad_core.outputs import (
    report_closures,
    write_closure_table,
    write_closures,
    write_map,
)
from gpgrad_core.pipeline import DetectionResult, detect_loop_closures, infer_map
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress
from gpgrad_core.run.threads import num_workers
from gpgrad_core.slam import build_pose_graph, optimise_pose_graph, write_graph
from gpgrad_core.slam.g2o import vertex_numbers

CLOSURES = {
    "JSON": "closures.json",
    "CSV": "closures.csv",
    "g2o": "graph.g2o",
    "TUM, corrected poses": "poses_corrected.txt",
}
"""File name by what is wanted of the loop closures."""

MAPS = {"NPZ": ".npz", "GeoTIFF": ".tif", "PLY mesh": ".ply", "PNG": ".png"}
"""Ending by the format of a map."""

PICTURE_TIMEOUT = 60.0
"""A page without a graphics card draws for seconds [s]."""


@dataclass(frozen=True, eq=False)
class Order:
    """A file that a page wants.

    Attributes:
        name: Of the file.
        client: The page.
        state: The session as it was when asked.
        write: Given the state, where to write, and a progress hook.
    """

    name: str
    client: viser.ClientHandle
    state: ViewState
    write: Callable[["Order", Path, Progress], None]


class Exports(Part):
    """Makes files in a thread of its own and sends them to the page that asked."""

    def __init__(
        self,
        host: Host,
        state: ViewState,
        memo: Memo,
        turns: threading.Semaphore,
        *,
        message_of: Callable[[Exception], str],
    ) -> None:
        """Make the panel in the current container.

        Args:
            host: Whose GUI it joins.
            state: The session as it is.
            memo: Shared with the pair that is shown.
            turns: Of what takes long.
            message_of: Says what went wrong in one line.
        """
        self._state = state
        self._memo = memo
        self._panel = ExportPanel(
            host,
            closures=tuple(CLOSURES),
            maps=tuple(MAPS),
            on_closures=self._order_closures,
            on_map=self._order_map,
            on_picture=self._order_picture,
            on_cancel=self._cancel,
        )
        self._maker: Runner[Order, bytes] = Runner(
            self._make,
            self._send,
            lambda order, error: self._panel.stopped(message_of(error), bad=True),  # noqa: ARG005
            on_cancel=lambda order: self._panel.stopped(f"Cancelled: {order.name}"),
            turns=turns,
            name="exports",
        )

    def follow(self, state: ViewState) -> None:
        """Take the session as it is; a file that is being made is of when it was asked for."""
        self._state = state

    def wait_idle(self, timeout: float) -> bool:
        """Wait until no file is being made; says whether that came true within [s]."""
        return self._maker.wait_idle(timeout)

    def close(self) -> None:
        """Stop."""
        self._maker.close()

    def _cancel(self) -> None:
        self._maker.cancel()

    def _order_closures(self, kind: str, client: viser.ClientHandle) -> None:
        self._order(CLOSURES[kind], client, self._write_closures)

    def _order_map(self, kind: str, role: str, client: viser.ClientHandle) -> None:
        state = self._state
        submap_id = state.query_id if role == "query" else state.database_id
        name = re.sub(r"[^\w.+-]+", "_", submap_id)

        def write(order: Order, path: Path, progress: Progress) -> None:
            submap = order.state.dataset.submap(submap_id)
            gradient_map = infer_map(submap, order.state.params, self._memo, progress)
            mask = order.state.params.features.max_std_ratio
            write_map(path, gradient_map, name=submap_id, max_std_ratio=mask)

        self._order(f"map_{name}{MAPS[kind]}", client, write)

    def _order_picture(self, client: viser.ClientHandle) -> None:
        self._order("view.png", client, _write_picture)

    def _order(
        self,
        name: str,
        client: viser.ClientHandle,
        write: Callable[[Order, Path, Progress], None],
    ) -> None:
        self._panel.running(name, 0.0)
        self._maker.submit(Order(name, client, self._state, write))

    def _make(self, order: Order, progress: Progress) -> bytes:
        def report(fraction: float) -> None:
            progress(fraction)
            self._panel.running(order.name, fraction)

        with tempfile.TemporaryDirectory(prefix="gpgrad-") as folder:
            path = Path(folder) / order.name
            order.write(order, path, report)
            return path.read_bytes()

    def _write_closures(self, order: Order, path: Path, progress: Progress) -> None:
        dataset, params = order.state.dataset, order.state.params
        if len(dataset.submaps) < 2:
            raise InputError(f"{dataset.name}: one submap alone closes no loop")
        with ThreadPoolExecutor(num_workers(), thread_name_prefix="export") as executor:
            result: DetectionResult = detect_loop_closures(
                dataset, params, executor=executor, memo=self._memo, progress=progress
            )
        match path.suffix:
            case ".g2o":
                write_graph(path, build_pose_graph(dataset, result.closures))
            case ".txt":
                graph = build_pose_graph(dataset, result.closures)
                solved, numbers = optimise_pose_graph(graph), vertex_numbers(graph)
                write_poses(path, {numbers[name]: pose for name, pose in solved.poses.items()})
            case ".csv":
                write_closure_table(path, report_closures(dataset, result, params))
            case _:
                write_closures(path, report_closures(dataset, result, params))

    def _send(self, order: Order, content: bytes, seconds: float) -> None:
        order.client.send_file_download(order.name, content, save_immediately=True)
        self._panel.stopped(f"{order.name}: {len(content):,} bytes in {seconds:.1f} s")


def _write_picture(order: Order, path: Path, progress: Progress) -> None:
    """Ask the page for what it shows; in a worker's thread, for the answer takes seconds."""
    progress(0.0)
    camera = order.client.camera
    try:
        picture = order.client.get_render(
            height=camera.image_height,
            width=camera.image_width,
            transport_format="png",
            timeout=PICTURE_TIMEOUT,
        )
    except TimeoutError as error:
        raise InputError(
            f"the page gave no picture within {PICTURE_TIMEOUT:.0f} s: bring its window to the "
            "front and try again"
        ) from error
    # With transparency, as PNG has it; OpenCV wants blue first.
    order_of = [2, 1, 0, 3][: picture.shape[2]]
    done, png = cv2.imencode(".png", np.ascontiguousarray(picture[..., order_of]))
    if not done:
        raise InputError("the picture could not be encoded")
    path.write_bytes(png.tobytes())
