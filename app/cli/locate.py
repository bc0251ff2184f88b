"""``gpgrad locate``: find submaps on a larger elevation model."""

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Annotated

import tyro
from typing_extensions import Doc

from app.cli.detect import tell_closure
from app.cli.flags import Overwrite
from app.cli.inputs import ALL_PARAMS, AllParams, DatasetPath, ParamsFile, base_params, load
from app.cli.terminal import conclude, progress_bar, say, warn, working
from gpgrad_core.errors import InputError, count
from gpgrad_core.io.folder import check_vacant, write_dataset
from gpgrad_core.io.georeference import read_origin
from gpgrad_core.io.rasters import read_elevation_model
from gpgrad_core.io.records.files import check_apart, check_output
from gpgrad_core.locating import Search
from gpgrad_core.mapping.gradient_map import NOISE_STD


@dataclass(frozen=True)
class Locate:
    """Arguments of ``gpgrad locate``."""

    dataset: DatasetPath
    map: Annotated[
        Path,
        Doc("GeoTIFF of the elevation model, in metres."),
        tyro.conf.arg(metavar="FILE.tif"),
    ]
    out: Annotated[
        Path,
        Doc("File to write the places to."),
        tyro.conf.arg(metavar="FILE.json"),
    ]
    merged: Annotated[
        bool,
        Doc(
            "Find the whole traverse as one, joined by its poses, instead of each submap alone. "
            "Coarse models need that."
        ),
    ] = False
    poses: Annotated[
        Path | None,
        Doc("File of the poses to join it by, such as the poses_corrected.txt of gpgrad slam."),
        tyro.conf.arg(metavar="FILE.txt", help_behavior_hint="(default: odometry)"),
    ] = None
    near: Annotated[
        str | None,
        Doc("Search only so far [m] around a place of the model: easting, northing, radius."),
        tyro.conf.arg(metavar="E,N,RADIUS", help_behavior_hint="(default: everywhere)"),
    ] = None
    map_noise: Annotated[
        float | None,
        Doc("Standard deviation of the model's heights [m]."),
        tyro.conf.arg(
            metavar="METRES",
            help_behavior_hint="(default: fitted, from what differs from cell to cell)",
        ),
    ] = None
    show: Annotated[
        Path | None,
        Doc(
            "Also write a dataset to this folder: the accepted submaps and the model, each at its "
            "place. gpgrad view shows it."
        ),
        tyro.conf.arg(metavar="FOLDER"),
    ] = None
    overwrite: Overwrite = False
    params: ParamsFile = None
    pipeline: AllParams = ALL_PARAMS

    def run(self) -> None:
        check_output(self.out, (".json",), overwrite=self.overwrite)
        check_apart([self.out, self.show], [self.dataset, self.map, self.poses, self.params])
        if self.show is not None:
            check_vacant(self.show, overwrite=self.overwrite)
        if self.map_noise is not None and not NOISE_STD.low <= self.map_noise <= NOISE_STD.high:
            raise InputError(
                f"--map-noise must be from {NOISE_STD.low} to {NOISE_STD.high} m, got "
                f"{self.map_noise:g}"
            )
        if self.poses is not None and not self.merged:
            raise InputError(f"--poses {self.poses}: joins the submaps, which --merged asks for")
        near = None if self.near is None else _read_circle(self.near)
        model = read_elevation_model(self.map)
        dataset = load(self.dataset)
        search = Search.of(
            dataset, model, self.map.name, merged=self.merged, poses=self.poses, near=near
        )
        start = perf_counter()
        asked = self.pipeline.over(base_params(dataset, self.params))
        with progress_bar("fit") as progress:
            params = search.fit(asked, self.map_noise, progress)
        query_map, model_map = params[0].map, params[1].map
        say(
            f"scale of comparison {query_map.scale:.3g} m; noise of the submaps "
            f"{query_map.noise_std:.3g} m, of the map {model_map.noise_std:.3g} m"
        )
        windows, submaps = search.windows, search.submaps
        with working("locate", len(windows) * len(submaps)) as (progress, executor):
            located = search.run(params, executor=executor, progress=progress)
        seconds = perf_counter() - start
        located.write(self.out)
        accepted, places = located.accepted, located.places
        if self.show is not None and not accepted:
            warn(f"--show {self.show}: no submap was found, so there is nothing to show")
        elif self.show is not None:
            write_dataset(located.shown(), self.show, overwrite=self.overwrite)
        best = max(places, key=lambda place: place.verdict.registration.score, default=None)
        for place in accepted:
            tell_closure(place.verdict, "locate")
        conclude(
            f"{len(accepted)} of {count(len(places), 'submap')} found on {self.map.name}"
            f"{located.precision}; {count(len(windows), 'window')} searched, {seconds:.1f} s: "
            f"{self.out}",
            *(
                (f"the best, {best.verdict.query_id}: {best.verdict.reason}",)
                if best is not None and not accepted
                else ()
            ),
            output=self.out,
            found=len(accepted),
            submaps=len(places),
            windows=len(windows),
            seconds=seconds,
        )


def _read_circle(text: str) -> tuple[float, float, float]:
    east, north, radius = read_origin(text)
    if radius <= 0:
        raise InputError(f"--near {text}: the radius must be above 0 m")
    return east, north, radius
