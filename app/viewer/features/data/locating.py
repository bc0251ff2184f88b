"""Find the submaps on a larger elevation model, and show where on it they lie."""

import tempfile
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import viser
from jaxtyping import UInt8

from app.viewer.charts import png_uri
from app.viewer.features.data.folders import inside
from app.viewer.features.desk import Desk, Feature
from app.viewer.features.work import Downloads, Work, safe_name
from app.viewer.scene.colors import hillshade
from app.viewer.session.news import SessionState
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewState
from app.viewer.widgets.actions import on_press, on_press_by, on_upload
from app.viewer.widgets.html import FAINT, box, paragraph, summary
from app.viewer.widgets.status import WorkBar
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.params import preferred_parameters
from gpgrad_core.reading.paths import check_name
from gpgrad_core.run import Progress, part

if TYPE_CHECKING:  # what this needs loads slowly, and few people use it
    from gpgrad_core.io.rasters import Elevations
    from gpgrad_core.locating import Located

MOST_PIXELS = 640
"""Of a side of the picture of the model."""
FOUND, NOT_FOUND = "#1a9850", "#d73027"
CELL = "padding:1px 3px;white-space:nowrap"
MOST_ROWS = 200
"""Of the list of submaps."""


@dataclass(frozen=True, eq=False)
class Job:
    """What is sought, and where."""

    state: ViewState
    model: Path | tuple[str, bytes]  # on the server, or the name and the content of an upload
    merged: bool

    @property
    def name(self) -> str:
        return str(self.model) if isinstance(self.model, Path) else self.model[0]


class LocateTool(Feature):
    """Finds the submaps of the open dataset on a GeoTIFF of the server, or one that is uploaded."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._located: Located | None = None
        gui, allowed = desk.host.gui, desk.permissions
        with gui.add_folder("Locate on an elevation model", expand_by_default=False):
            self._path = gui.add_text(
                "Model",
                "",
                hint="A GeoTIFF of heights in metres, on the machine that runs the viewer.",
            )
            self._merged = gui.add_checkbox(
                "As one traverse",
                False,
                hint="Finds all submaps as one, joined by odometry. Coarse models need that.",
            )
            start = gui.add_button("Locate", hint="Searches the whole model for every submap.")
            upload = gui.add_upload_button(
                "Upload a GeoTIFF and locate",
                mime_type=".tif,.tiff",
                visible=allowed.uploads is not None,
                hint=f"Up to {allowed.max_upload / 1e6:,.0f} MB.",
            )
            self.bar = WorkBar(desk.host, "Cancel locating", "locating", starts=(start,))
            self.result = gui.add_html("")
            self._show = gui.add_button(
                "Open on the model",
                visible=False,
                hint="Opens the submaps that were found and the ground around them as a dataset.",
            )
            self._save = gui.add_button(
                "Save located.json", visible=False, hint="Saves what gpgrad locate writes."
            )
        on_press(start, self._start)
        on_press(self._show, self._open)
        on_press_by(self._save, self._download)
        on_upload(upload, self._upload)
        self._work: Work[Job, Located] = Work(
            desk.jobs,
            self.bar,
            lambda job: f"Searching {Path(job.name).name}",
            self._locate,
            self._on_located,
            slots=desk.capacity.long,
        )
        self._downloads = Downloads(desk.jobs, self.bar, desk.capacity.long)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        if state.view.dataset is before.view.dataset:
            return
        self._work.cancel()
        self.bar.idle()
        self._tell(None)

    def _start(self) -> None:
        path = self._path.value.strip()
        if not path:
            self.bar.failed("Type the path of a GeoTIFF first, or upload one.")
            return
        self._work.start(Job(self._desk.state, Path(path), self._merged.value))

    def _upload(self, name: str, content: bytes) -> None:
        self._work.start(Job(self._desk.state, (name, content), self._merged.value))

    # What the worker does.

    def _locate(self, job: Job, progress: Progress) -> "Located":
        from gpgrad_core.locating import Search  # noqa: PLC0415 - loads slowly

        progress(0.0)
        search = Search.of(job.state.dataset, *self._read(job), merged=job.merged)
        params = search.fit(job.state.asked, progress=part(progress, 0.0, 0.2))
        return search.run(params, progress=part(progress, 0.2, 1.0))

    def _read(self, job: Job) -> tuple["Elevations", str]:
        """Read the model; of an upload, nothing stays."""
        from gpgrad_core.io.rasters import read_elevation_model  # noqa: PLC0415 - loads slowly

        if isinstance(job.model, Path):
            root = self._desk.permissions.root
            path = job.model.expanduser() if root is None else inside(root, job.model)
            return read_elevation_model(path), path.name
        name, content = check_name(job.model[0]).name, job.model[1]
        with tempfile.TemporaryDirectory(dir=self._desk.permissions.uploads) as folder:
            path = Path(folder) / name
            path.write_bytes(content)
            try:
                return read_elevation_model(path), name
            except InputError as error:
                raise InputError(str(error).replace(str(InputError(path)), name)) from None

    # What came of it.

    def _on_located(self, job: Job, found: "Located", _seconds: float) -> None:
        if job.state.dataset is self._desk.state.dataset:
            self._tell(found)

    def _tell(self, found: "Located | None") -> None:
        self._located = found
        self.result.content = "" if found is None else found_html(found)
        self._save.visible = found is not None
        self._show.visible = found is not None and bool(found.accepted)

    def _open(self) -> None:
        if self._located is not None:
            dataset = self._located.shown()
            self._desk.open(Opened(dataset, preferred_parameters(dataset, PipelineParams()), ""))

    def _download(self, page: viser.ClientHandle) -> None:
        found = self._located
        if found is not None:
            name = f"{safe_name(found.dataset.name, 'dataset')}-located.json"
            self._downloads.order(page, name, lambda path, _progress: found.write(path))


def found_html(found: "Located") -> str:
    """Write how many were located, a picture of the model with all of them, and a list."""
    from gpgrad_core.locating import spread  # noqa: PLC0415 - loads slowly

    rows: list[str] = []
    for submap, place in zip(found.submaps, found.places, strict=True):
        sigma = spread(place)
        mark = f'<span style="color:{FOUND}">●</span>' if place.verdict.accepted else "✕"
        where = ("", "")
        if place.pose is not None:
            where = tuple(f"{value:.1f}" for value in place.pose.apply(submap.centre[None])[0, :2])
        cells = (*where, "" if sigma is None else f"{sigma.max():.2g}")
        inner = "".join(f'<td style="{CELL};text-align:right">{cell}</td>' for cell in cells)
        reason, name = (escape(text) for text in (place.verdict.reason, place.verdict.query_id))
        rows.append(f'<tr title="{reason}"><td style="{CELL}">{mark} {name}</td>{inner}</tr>')
    head = f"{len(found.accepted)} of {len(found.places)} found on {found.name}{found.precision}."
    names = ("Submap", "East [m]", "North [m]", "± [m]")
    top = "".join(f'<th style="{CELL};font-weight:400;{FAINT}">{name}</th>' for name in names)
    rest = len(rows) - MOST_ROWS
    more = paragraph(f"{rest:,} more are in located.json.") if rest > 0 else ""
    return (
        summary(
            "located", (head, "● found, ✕ likeliest place of one that is refused. North is up.")
        )
        + box("located-model", model_picture(found))
        + '<div style="max-height:16em;overflow-y:auto;padding:0 .75em"><table style="width:100%;'
        'font-size:12px;font-variant-numeric:tabular-nums;border-collapse:collapse">'
        f"<tr>{top}</tr>{''.join(rows[:MOST_ROWS])}</table></div>{more}"
    )


def model_picture(found: "Located") -> str:
    """Draw the model from above, lit from the upper left, and where the submaps lie."""
    model = found.model
    every = -(-max(model.heights.shape) // MOST_PIXELS)
    pixels = lit(model, every)
    height, width = pixels.shape[:2]
    size = 0.015 * max(height, width)
    marks: list[str] = []
    found_last = sorted(
        zip(found.submaps, found.places, strict=True), key=lambda both: both[1].verdict.accepted
    )
    for submap, place in found_last:
        if place.pose is None:
            continue
        east, north, _ = place.pose.apply(submap.centre[None])[0]
        x = (east - model.corner[0]) / model.cell[0] / every
        y = height - 1 - (north - model.corner[1]) / model.cell[1] / every
        at, name = f"translate({x:.1f} {y:.1f})", escape(place.verdict.query_id)
        if place.verdict.accepted:
            mark = f'<circle r="{size:.1f}" fill="{FOUND}" stroke="#fff" stroke-width="2"/>'
        else:
            cross = f"M-{size:.1f} -{size:.1f}L{size:.1f} {size:.1f}M-{size:.1f} {size:.1f}"
            mark = (
                f'<path d="{cross}L{size:.1f} -{size:.1f}" stroke="{NOT_FOUND}" stroke-width="4"/>'
            )
        label = (
            f'<text x="{1.5 * size:.1f}" y="{0.8 * size:.1f}" font-size="{2.4 * size:.0f}" '
            f'paint-order="stroke" stroke="#fff" stroke-width="3" fill="#000">{name}</text>'
        )
        marks.append(f'<g transform="{at}"><title>{name}</title>{mark}{label}</g>')
    return (
        f'<svg role="img" aria-label="Where the submaps lie on the model" width="100%" '
        f'viewBox="0 0 {width} {height}" style="display:block;max-height:26em;margin:.4em 0">'
        f'<image href="{png_uri(pixels)}" width="{width}" height="{height}"/>{"".join(marks)}</svg>'
    )


def lit(model: "Elevations", every: int) -> UInt8[NDArray[np.uint8], "rows columns 4"]:
    """Light every n-th height; the picture's first row is in the north, and holes are clear."""
    heights = model.heights[::every, ::every]
    spaced = np.pad(heights, ((0, heights.shape[0] == 1), (0, heights.shape[1] == 1)), "edge")
    along_y, along_x = np.gradient(spaced, every * model.cell[1], every * model.cell[0])
    known = np.isfinite(along_x) & np.isfinite(along_y)
    slope = np.stack([along_x, along_y], axis=-1)[: heights.shape[0], : heights.shape[1]]
    known = known[: heights.shape[0], : heights.shape[1]]
    steep = np.quantile(np.linalg.norm(slope[known], axis=-1), 0.9) if known.any() else 0.0
    slope = np.where(known[..., None], slope, 0.0) * (0.6 / max(float(steep), 1e-9))
    light = np.clip(150.0 * hillshade(slope.reshape(-1, 2)), 0, 255).reshape(known.shape)
    grey = light.astype(np.uint8)[..., None].repeat(3, axis=-1)
    alpha = np.where(known, 255, 0).astype(np.uint8)[..., None]
    return np.concatenate([grey, alpha], axis=-1)[::-1]
