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
from gpgrad_core import locating
from gpgrad_core.errors import InputError, count
from gpgrad_core.io.folder import check_vacant, index_of, write_dataset
from gpgrad_core.io.georeference import read_origin
from gpgrad_core.io.poses import read_poses
from gpgrad_core.io.rasters import read_elevation_model
from gpgrad_core.io.records.files import check_apart, check_output
from gpgrad_core.mapping.gradient_map import NOISE_STD
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset


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
        cell = max(model.cell)
        dataset = load(self.dataset)
        submaps = list(dataset.submaps)
        if self.merged:
            poses = _poses_of(dataset, self.poses)
            submaps = [locating.merge_submaps(submaps, poses, locating.CELLS_A_VOXEL * cell)]
        windows = locating.cut_windows(model, max(map(locating.width_of, submaps)), near)
        start = perf_counter()
        with progress_bar("fit") as progress:
            params = locating.parameters_for(
                submaps,
                windows,
                cell,
                self.pipeline.over(base_params(dataset, self.params)),
                self.map_noise,
                progress,
            )
        query_map, model_map = params[0].map, params[1].map
        say(
            f"scale of comparison {query_map.scale:.3g} m; noise of the submaps "
            f"{query_map.noise_std:.3g} m, of the map {model_map.noise_std:.3g} m"
        )
        with working("locate", len(windows) * len(submaps)) as (progress, executor):
            places = locating.locate(submaps, windows, params, executor=executor, progress=progress)
        seconds = perf_counter() - start
        located = locating.Located(
            dataset, model, self.map.name, submaps, places, params, len(windows)
        )
        located.write(self.out)
        accepted = located.accepted
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


def _poses_of(dataset: Dataset, path: Path | None) -> list[Pose]:
    numbers = {submap.id: index_of(submap.id) for submap in dataset.submaps}
    names = {number: name for name, number in numbers.items() if number is not None}
    read = {} if path is None else read_poses(path, names)
    poses: list[Pose] = []
    for submap in dataset.submaps:
        number = numbers[submap.id]
        named = None if number is None else read.get(number)
        pose = submap.pose_odometry if path is None else named
        if pose is None:
            raise InputError(
                f"{path or dataset.name}: has no pose of submap {submap.id}, and the traverse "
                "is joined by its poses; leave --merged out, or add it"
            )
        poses.append(pose)
    return poses
