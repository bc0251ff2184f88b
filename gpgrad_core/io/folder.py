"""A folder of clouds with poses -> a dataset, and back."""

import os
import re
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from gpgrad_core.errors import InputError, NoTerrainError, readable
from gpgrad_core.ground import submap_of_cloud
from gpgrad_core.io.clouds import (
    CLOUD_ENDINGS,
    format_of,
    is_cloud,
    left_out_notes,
    load_cloud_with_notes,
)
from gpgrad_core.io.clouds.ply import write_ply
from gpgrad_core.io.dataset_toml import read_dataset_toml, write_dataset_toml
from gpgrad_core.io.poses import (
    PosedScan,
    find_posed_scans,
    poses_at,
    read_poses,
    read_positions,
    write_poses,
    write_positions,
)
from gpgrad_core.reading.paths import DAY, check_path, in_order, seconds_in, with_distinct_numbers
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.folders import whole_folder
from gpgrad_core.run.memo import array_bytes
from gpgrad_core.run.memory import Spool
from gpgrad_core.run.parallel import run_jobs
from gpgrad_core.se2 import Pose, level_pose
from gpgrad_core.types import Dataset, Extent, GroundChoice, Submap, SubmapSource

CLOUD_FOLDER = "submaps"
TRUTH_FILE = "poses_gt.txt"
POSITIONS_FILE = "positions_gt.txt"  # read where there are no true poses
ODOMETRY_FILES = ("poses_odom.txt", "poses.txt")  # the first one that exists is read
INFO_FILE = "dataset.toml"
NO_POINTS = np.empty((0, 3))
OF_POINTS = ("points", "colors", "noise_std", "ranges", "left_out")
"""What a submap has of each of its points, and those that were left out."""
MOST_LOADED = 100_000_000
"""Most bytes of points that `open_dataset` and the viewer hold in memory, and that processes send
each other."""
JOURNAL = "build.jsonl"
"""Name of the journal of a build; it tells what the submaps were made of."""
SIMULATED = "gpgrad simulate"
"""Stands in the description, or above the poses, of what was simulated."""
DATASET_FOLDERS = {
    CLOUD_FOLDER: (".ply", ODOMETRY_FILES[0]),
    "trajectory": (".txt", ODOMETRY_FILES[0]),
    "scans": (".ply", "times.txt"),
}
"""Folders that gpgrad writes into a dataset or a recording: the ending of their files, and the file
whose rows begin with their names."""
DATASET_ENTRIES = (
    *DATASET_FOLDERS,
    *(TRUTH_FILE, POSITIONS_FILE, *ODOMETRY_FILES, "times.txt", INFO_FILE, JOURNAL),
)
"""What gpgrad writes into a dataset or a recording."""
CloudFile: TypeAlias = tuple[Path, Pose | None, GroundChoice]
"""A file, ``T_submap_sensor`` if it is in the frame of its sensor, and what of it is left out."""


@dataclass(frozen=True, eq=False)
class Outline:
    """A dataset whose clouds are loaded one at a time, when they are needed.

    Attributes:
        dataset: The dataset without its clouds: its submaps have ids and poses, but no points.
        clouds: The file of each submap.
        sensors: ``T_submap_sensor`` of each cloud that is in the frame of its sensor, else None;
            nothing if no cloud is.
        extents: Where the points of each submap lie that was loaded, by its number.
    """

    dataset: Dataset
    clouds: tuple[Path, ...]
    sensors: tuple[Pose | None, ...] = ()
    extents: dict[int, Extent] = field(default_factory=dict)

    def sensor(self, k: int) -> Pose | None:
        return self.sensors[k] if self.sensors else None

    def load(self, k: int) -> tuple[Submap, tuple[str, ...]]:
        """Load submap number k, with notes on what was left out; InputError names a broken file."""
        submap, notes = _load(self.clouds[k], self.sensor(k), self.dataset.ground)
        self.extents[k] = submap.extent
        return _completed(submap, self.dataset.submaps[k]), notes

    def file(self, k: int, submap: Submap) -> "SubmapFile":
        """Submap number k, which was loaded, as one that is read again when it is needed."""
        bare = replace(submap, points=NO_POINTS, **dict.fromkeys(OF_POINTS[1:]))
        place, sensor = self.clouds[k].absolute(), self.sensor(k)
        return SubmapFile(place, bare, submap.num_points, sensor, self.dataset.ground)

    @property
    def measured(self) -> Dataset:
        """The dataset, whose submaps know their extents; loads those that never were loaded."""
        for _ in self.terrains(k for k in range(len(self.clouds)) if k not in self.extents):
            pass
        submaps = tuple(
            replace(submap, extent=self.extents[k]) if k in self.extents else submap
            for k, submap in enumerate(self.dataset.submaps)
        )
        return replace(self.dataset, submaps=submaps)

    def terrains(self, numbers: Iterable[int]) -> Iterator[Submap]:
        """Load some submaps one by one, without those of which no map can be made."""
        for k in numbers:
            with suppress(NoTerrainError):
                yield self.load(k)[0]


@dataclass(frozen=True, eq=False)
class SubmapFile:
    """A submap that is read from its file whenever it is needed; a `SubmapSource`."""

    path: Path
    outlined: Submap  # the submap without its points
    num_points: int
    sensor: Pose | None  # ``T_submap_sensor`` if the points are in the frame of the sensor
    ground: GroundChoice  # whether what stands on the ground is left out

    @property
    def id(self) -> str:
        return self.outlined.id

    @property
    def fingerprint(self) -> str:
        """Hash of the points when the file was first read."""
        return self.outlined.fingerprint

    def load(self) -> Submap:
        """Read the file; InputError if it cannot be read any more, or its content has changed."""
        # Where nothing was left out, nothing is now, if the points are still the same.
        is_whole = self.outlined.num_outliers == self.outlined.num_non_ground == 0
        submap, _ = _load(self.path, self.sensor, None if is_whole else self.ground)
        if submap.fingerprint != self.fingerprint:
            raise InputError(f"{self.path}: has changed since the run began; start it again")
        return _completed(submap, self.outlined)


def _load(
    path: Path, sensor: Pose | None, ground: GroundChoice | None
) -> tuple[Submap, tuple[str, ...]]:
    """Load a cloud, and bring it from the frame of its sensor into a level one if need be."""
    if sensor is None:
        return load_cloud_with_notes(path, ground)
    submap, notes = load_cloud_with_notes(path, None if ground is None else "all")
    points = sensor.apply(submap.points)
    try:
        level = submap_of_cloud(points, submap.id, ground=ground)
    except InputError as error:  # a wall, for instance, is a line from above
        raise type(error)(f"{path}: {str(error).removeprefix(f'{submap.id}: ')}") from None
    notes += tuple(left_out_notes(level, path.name))
    num_outliers = submap.num_outliers + level.num_outliers
    return replace(level, num_dropped=submap.num_dropped, num_outliers=num_outliers), notes


def _completed(submap: Submap, outlined: Submap) -> Submap:
    """Add to a cloud what the dataset knows of the submap."""
    return replace(
        submap,
        id=outlined.id,
        pose_true=outlined.pose_true,
        pose_odometry=outlined.pose_odometry,
        images=outlined.images,
    )


def open_dataset(
    path: Path | str | Outline,
    progress: Progress = silent,
    *,
    check: Callable[[Submap], None] | None = None,
    most_bytes: int = MOST_LOADED,
    executor: Executor | None = None,
) -> tuple[Dataset, tuple[SubmapSource, ...]]:
    """Read a dataset of any size: all clouds are read once, and only some are kept in memory.

    So a broken cloud is found before the work begins, as by `load_dataset`.

    Args:
        path: Folder or file, as for `load_dataset`, or what `outline_dataset` has read of it.
        progress: Called once per cloud.
        check: Called with each submap; an error that it raises ends the reading.
        most_bytes: Bytes of points to keep in memory; all further submaps are read again from
            their files when they are needed.
        executor: Reads several clouds at a time; None reads one after the other.

    Returns:
        The dataset, whose submaps lack their points, and the sources of its submaps.

    Raises:
        InputError: See `load_dataset`.
    """
    outline = path if isinstance(path, Outline) else outline_dataset(path)
    sources: list[SubmapSource] = []
    outlined: list[Submap] = []
    held = 0

    def take(k: int, submap: Submap) -> None:
        nonlocal held
        if check is not None:
            check(submap)
        held += array_bytes(submap)
        outlined.append(replace(outline.dataset.submaps[k], extent=submap.extent))
        sources.append(submap if held <= most_bytes else outline.file(k, submap))

    dataset = _read_clouds(outline, take, progress, executor)
    return replace(dataset, submaps=tuple(outlined)), tuple(sources)


def _read_clouds(
    outline: Outline,
    take: Callable[[int, Submap], None],
    progress: Progress,
    executor: Executor | None = None,
) -> Dataset:
    """Load all submaps, and hand each over; gives the dataset with notes, without those lost."""
    lost: dict[int, NoTerrainError] = {}
    notes, count = list(outline.dataset.notes), 0

    def took(loaded: tuple[Submap, tuple[str, ...]] | NoTerrainError) -> None:
        nonlocal notes, count
        k, count = count, count + 1
        if isinstance(loaded, NoTerrainError):
            lost[k] = loaded
            return
        take(k, _completed(loaded[0], outline.dataset.submaps[k]))
        notes += loaded[1]

    ground: GroundChoice = outline.dataset.ground
    files: list[CloudFile] = [
        (cloud, outline.sensor(k), ground) for k, cloud in enumerate(outline.clouds)
    ]
    run_jobs(_load_file, files, executor, progress, took)
    return _without(replace(outline.dataset, notes=tuple(notes)), lost)


def _load_file(
    file: CloudFile, progress: Progress
) -> tuple[Submap, tuple[str, ...]] | NoTerrainError:
    try:
        loaded = _load(*file)
    except NoTerrainError as error:
        loaded = error
    progress(1.0)
    return loaded


def _without(dataset: Dataset, lost: Mapping[int, NoTerrainError]) -> Dataset:
    """Drop the submaps without a terrain, with a note on each."""
    if len(lost) == len(dataset.submaps):
        raise lost[0]
    names = [dataset.submaps[k].id for k in lost]
    notes = (f"{error}: it was left out" for error in lost.values())
    return replace(
        dataset,
        submaps=tuple(submap for k, submap in enumerate(dataset.submaps) if k not in lost),
        preferred={key: value for key, value in dataset.preferred.items() if value not in names},
        notes=(*dataset.notes, *notes),
    )


def load_dataset(
    path: Path | str,
    progress: Progress = silent,
    *,
    most_bytes: int | None = None,
    on_submap: Callable[[Submap], None] | None = None,
) -> Dataset:
    """Load a dataset folder, a bare folder of clouds, or a single cloud.

    A dataset folder has ``submaps/``, and optionally ``poses_gt.txt``, ``poses_odom.txt`` (or
    ``poses.txt``) and ``dataset.toml``. A submap's index is the last number in its file's name.
    Gaps in the numbering, missing poses and extra files are fine. A cloud of which no map can be
    made, such as one of a line, is left out of a folder. A folder of scans with a pose
    each, ``NAME/NAME.xyz`` with ``NAME/NAME.gt``, is a dataset too; see `find_posed_scans`.

    Args:
        path: Folder or file.
        progress: Called once per cloud.
        most_bytes: Bytes of points to keep in memory. Further ones wait in a temporary file, and
            are used like any others. None keeps all in memory.
        on_submap: Called with each submap as soon as it is read.

    Returns:
        The submaps sorted by their numbers; submaps without a number are last, sorted by name.
        ``notes`` reports what was left out or ignored.

    Raises:
        InputError: If something is missing, broken or contradictory; the message names the file,
            and in a text file also the line. Or if the disk is too full for the temporary file.
    """
    submaps: list[Submap] = []
    held = 0
    with closing(Spool()) as spool:

        def take(_: int, submap: Submap) -> None:
            nonlocal held
            held += array_bytes(submap)
            if most_bytes is not None and held > most_bytes:
                try:
                    submap = spooled(submap, spool)
                except OSError as error:
                    raise InputError(
                        f"{tempfile.gettempdir()}: the points cannot wait there: "
                        f"{error.strerror or error}; make room, or name another folder in TMPDIR"
                    ) from None
            submaps.append(submap)
            if on_submap is not None:
                on_submap(submap)

        dataset = _read_clouds(outline_dataset(path), take, progress)
    return replace(dataset, submaps=tuple(submaps))


def spooled(submap: Submap, spool: Spool) -> Submap:
    """Move all values of a submap's points into a file; OSError if the disk is full."""
    arrays = {name: getattr(submap, name) for name in OF_POINTS}
    return replace(submap, **{name: spool.put(a) for name, a in arrays.items() if a is not None})


def outline_dataset(path: Path | str) -> Outline:
    """Read a dataset without its clouds; see `load_dataset`."""
    path = check_path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if not path.is_dir():
        format_of(path)
        return Outline(Dataset(path.stem, (_without_points(path.stem),)), (path,))
    with readable(path):
        return _outline_folder(path)


def _outline_folder(path: Path) -> Outline:
    has_submaps = (path / "submaps").is_dir()
    clouds, ignored = _find_clouds(path / "submaps" if has_submaps else path)
    scans = [] if has_submaps else find_posed_scans(path)
    if scans and (not clouds or not scans[0].true):  # GLIM's own files end in .bin
        return _outline_scans(path, scans)
    if not clouds:
        message = f"{path / 'submaps' if has_submaps else path}: holds no clouds ({CLOUD_ENDINGS})"
        inner = sorted(e.name for e in path.iterdir() if (e / "submaps").is_dir())
        if inner and not has_submaps:
            message += f"; it holds the datasets {', '.join(inner[:5])}; give one of them"
        raise InputError(message)
    # A folder of loose clouds may hold anything else; in submaps/ another file is reported.
    notes = [f"submaps/{name}: is not a cloud and was ignored" for name in ignored if has_submaps]
    first, cloud = next(iter(clouds.items()))
    if first != cloud.stem:
        notes.append(f"{cloud.name}: is submap {first}, by the number that differs, and so on")
    indices = {index for name in clouds if (index := index_of(name)) is not None}
    info = Dataset("", ())
    if (path / INFO_FILE).exists():
        info = read_dataset_toml(path / INFO_FILE, frozenset(clouds))
    truth = read_poses(path / TRUTH_FILE, indices) if (path / TRUTH_FILE).exists() else {}
    odometry: dict[int, Pose] = {}
    present = [path / name for name in ODOMETRY_FILES if (path / name).exists()]
    if present:
        odometry = read_poses(present[0], indices)
        notes += [
            f"{file.name}: was ignored, because there is also {present[0].name}"
            for file in present[1:]
        ]
    positions_only = not truth and (path / POSITIONS_FILE).exists()
    if positions_only:
        truth = poses_at(read_positions(path / POSITIONS_FILE, indices), odometry)
        notes.append(
            f"{POSITIONS_FILE}: has true positions without headings; the headings are those of "
            "odometry, turned onto the positions nearby, and turns are not judged"
            if truth
            else f"{POSITIONS_FILE}: was ignored, because the traverse has no odometry to give "
            "headings, or is shorter than 2 m"
        )
    submaps: list[Submap] = []
    for name in clouds:
        index = index_of(name)
        number = -1 if index is None else index  # no pose has that
        images = _find_images(path / "images", number)
        poses = truth.get(number), odometry.get(number)
        submaps.append(replace(_without_points(name, *poses), images=images))
    dataset = replace(
        info,
        name=info.name or path.resolve().name,
        submaps=tuple(submaps),
        notes=(*info.notes, *notes),
        positions_only=positions_only and bool(truth),
    )
    return Outline(dataset, tuple(clouds.values()))


def _outline_scans(path: Path, scans: Sequence[PosedScan]) -> Outline:
    """Outline a folder of scans with a pose each: every scan is a submap."""
    submaps: list[Submap] = []
    sensors: list[Pose | None] = []
    are = "the true ones, and there is no odometry" if scans[0].true else "those of odometry"
    notes = [
        f"{path.name}: each scan is a submap, made level by its pose in {scans[0].source.name} and "
        f"so on; these poses are {are}"
    ]
    for scan in scans:
        if scan.pose is None:
            notes.append(f"{scan.name}: has no pose in {scan.source.name}; it is taken as level")
            submaps.append(_without_points(scan.name))
            sensors.append(None)
            continue
        level = level_pose(scan.pose)
        poses = (level, None) if scan.true else (None, level)
        submaps.append(_without_points(scan.name, *poses))
        sensors.append(level.inverse() @ scan.pose)
    dataset = Dataset(name=path.resolve().name, submaps=tuple(submaps), notes=tuple(notes))
    return Outline(dataset, tuple(scan.cloud for scan in scans), tuple(sensors))


def _without_points(name: str, true: Pose | None = None, odometry: Pose | None = None) -> Submap:
    return Submap(name, NO_POINTS, fingerprint="", pose_true=true, pose_odometry=odometry)


def _find_images(folder: Path, index: int) -> tuple[Path, ...]:
    """List the images in the folder of a submap's number, sorted by name."""
    if not folder.is_dir():
        return ()
    own = [f for f in in_order([*folder.iterdir()]) if f.is_dir() and index_of(f.name) == index]
    return tuple(
        file
        for inner in own
        for file in in_order([*inner.iterdir()])
        if file.suffix.lower() in (".png", ".jpg", ".jpeg") and not file.name.startswith(".")
    )


def index_of(submap_id: str) -> int | None:
    """Find a submap's index: the last number in its name; of a time, nanoseconds or digits.

    >>> index_of("submap_007"), index_of("crater"), index_of("1700000000.25")
    (7, None, 1700000000250000000)
    >>> index_of("2021-03-04-10-59-55")
    20210304105955
    """
    time = seconds_in(submap_id)
    if time:
        return int(time[0] + time[1].ljust(9, "0"))
    day = re.search(f"{DAY}$", submap_id)
    if day:
        return int(re.sub("[^0-9]", "", day[0]))
    numbers = re.findall(r"[0-9]+", submap_id)
    return int(numbers[-1]) if numbers else None


def _find_clouds(folder: Path) -> tuple[dict[str, Path], list[str]]:
    """List the clouds in order by their ids, and the names of all other files."""
    clouds = list_clouds(folder)
    owners: dict[int | str, Path] = {}
    for cloud, submap_id in sorted((cloud, submap_id) for submap_id, cloud in clouds):
        key, what = _key(submap_id)
        if key in owners:
            raise InputError(
                f"{folder}: {owners[key].name} and {cloud.name} both have the {what} {key}; "
                "rename or remove one"
            )
        owners[key] = cloud
    others = {entry.name for entry in folder.iterdir()} - {cloud.name for _, cloud in clouds}
    return dict(clouds), sorted(name for name in others if not name.startswith("."))


def list_clouds(folder: Path) -> list[tuple[str, Path]]:
    """List the clouds of a folder with the ids of their submaps, in order."""
    # Files whose names start with a dot are the system's, such as .DS_Store and ._000.ply.
    entries = sorted(entry for entry in folder.iterdir() if not entry.name.startswith("."))
    clouds = [e for e in entries if is_cloud(e) and not e.is_dir()]  # a pipe is refused later
    ids = with_distinct_numbers([cloud.stem for cloud in clouds])

    def order(one: tuple[str, Path]) -> tuple[bool, int, str]:
        index = index_of(one[0])
        return index is None, index or 0, one[0]

    return sorted(zip(ids, clouds, strict=True), key=order)


def _key(submap_id: str) -> tuple[int | str, str]:
    """The key that identifies a submap, which must be unique, and its kind."""
    index = index_of(submap_id)
    return (submap_id, "name") if index is None else (index, "number")


def write_dataset(
    dataset: Dataset,
    directory: Path | str,
    progress: Progress = silent,
    *,
    overwrite: bool = False,
) -> None:
    """Write a dataset folder; a reader never sees it half-written.

    Args:
        dataset: The dataset; its submaps' ids become the file names.
        directory: The folder; it is made with its parents if it does not exist.
        progress: Called once per cloud.
        overwrite: Whether to replace a dataset that gpgrad made.

    Raises:
        InputError: If the directory is taken or cannot be made, if another process is writing it,
            if an id cannot be a file name, or if a submap has a pose but no number, by which pose
            files name it.
    """
    _check_ids(dataset)
    with new_folder(Path(directory), overwrite=overwrite) as unfinished:
        (unfinished / CLOUD_FOLDER).mkdir(parents=True)
        for count, submap in enumerate(dataset.submaps, start=1):
            extras = {"noise_std": submap.noise_std, "range": submap.ranges}
            numbers = {name: values for name, values in extras.items() if values is not None}
            cloud = unfinished / CLOUD_FOLDER / f"{submap.id}.ply"
            write_ply(cloud, submap.points, submap.colors, numbers)
            progress(count / len(dataset.submaps))
        named = {k: submap for submap in dataset.submaps if (k := index_of(submap.id)) is not None}
        truth = {k: pose for k, submap in named.items() if (pose := submap.pose_true)}
        odometry = {k: pose for k, submap in named.items() if (pose := submap.pose_odometry)}
        write_all_but_clouds(unfinished, dataset, truth, odometry)


@contextmanager
def new_folder(directory: Path, *, overwrite: bool = False) -> Generator[Path]:
    """Provide a temporary folder to write to; it gets its name if the block succeeds."""
    check_vacant(directory, overwrite=overwrite)
    try:
        with whole_folder(directory, replace=overwrite) as unfinished:
            check_vacant(directory, overwrite=overwrite)  # another process may just have ended
            yield unfinished
    except OSError as error:
        if error.strerror is None:  # a process has died
            raise
        raise InputError(f"{directory}: cannot be written: {error.strerror}") from None


def check_vacant(directory: Path | str, *, overwrite: bool = False) -> None:
    """Check that a new dataset, or with `overwrite` another of gpgrad, can be written there."""
    directory = Path(directory)
    if directory.exists() and not directory.is_dir():
        raise InputError(f"{directory}: is a file; name a new or empty folder")
    if directory.exists() and any(directory.iterdir()):
        if not overwrite:
            raise InputError(
                f"{directory}: is not empty; name a new or empty folder, or replace what gpgrad "
                "made there: --overwrite"
            )
        _check_is_dataset(directory)
    above = next(folder for folder in directory.absolute().parents if folder.exists())
    if above.is_dir() and not os.access(above, os.W_OK | os.X_OK):
        raise InputError(f"{directory}: cannot be written: no permission to write to {above}")


def _check_is_dataset(directory: Path) -> None:
    """Refuse to replace a folder that holds anything that gpgrad did not make."""
    others = sorted(e.name for e in directory.iterdir() if e.name not in DATASET_ENTRIES)
    signed = (directory / JOURNAL).is_file() or any(
        SIMULATED in _text(directory / name) for name in (INFO_FILE, *ODOMETRY_FILES)
    )
    if signed and not others:
        for folder, (ending, list_file) in DATASET_FOLDERS.items():
            rows = map(str.split, _text(directory / list_file).splitlines())
            written = {row[0].zfill(3) + ending for row in rows if row}
            entries = sorted((directory / folder).glob("*"))
            others += [
                f"{folder}/{entry.name}"
                for entry in entries
                if entry.name not in written or not entry.is_file()
            ]
    if others:
        raise InputError(
            f"{directory}: holds {others[0]}, which is no part of a dataset that gpgrad made; "
            "move it away, or name another folder"
        )
    if not signed:
        raise InputError(
            f"{directory}: gpgrad did not make what is there; remove it yourself, or name another "
            "folder"
        )


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""


def _check_ids(dataset: Dataset) -> None:
    owners: dict[int | str, str] = {}
    for submap in dataset.submaps:
        if Path(submap.id).name != submap.id or submap.id.startswith("."):
            raise InputError(f"{dataset.name}: the id {submap.id!r} cannot be a file name")
        key, what = _key(submap.id)
        if what == "name" and (submap.pose_true or submap.pose_odometry):
            raise InputError(
                f"{dataset.name}: submap {submap.id!r} has a pose, but its id has no number by "
                "which a pose file could name it"
            )
        if key in owners:
            raise InputError(
                f"{dataset.name}: the ids {owners[key]!r} and {submap.id!r} both have the {what} "
                f"{key}"
            )
        owners[key] = submap.id


def write_all_but_clouds(
    folder: Path, dataset: Dataset, truth: dict[int, Pose], odometry: dict[int, Pose]
) -> None:
    """Write the poses, by the submaps' numbers, and what a dataset is; it needs no points."""
    if dataset.positions_only:
        places = {number: pose.translation for number, pose in truth.items()}
        write_positions(folder / POSITIONS_FILE, places)
    elif truth:
        write_poses(folder / TRUTH_FILE, truth)
    if odometry:
        write_poses(folder / ODOMETRY_FILES[0], odometry)
    write_dataset_toml(folder / INFO_FILE, dataset)
