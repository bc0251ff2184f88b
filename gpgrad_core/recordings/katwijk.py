"""A traverse of the Katwijk beach planetary rover dataset -> a recording.

The dataset is that of Hewitt et al., *The Katwijk beach planetary rover dataset* (IJRR 2018). In
the folder of a part of a traverse, ``Velodyne/`` has three images for each turn of a VLP-16:
``Velodyne_TIME_range.png`` [mm], ``…_azimuth.png`` [0.01 degrees] and ``…_intensity.png``, each of
16 rows and 1808 columns; a range of 0 is no return. TIME is year, month, day, hours, minutes,
seconds and milliseconds, joined by underscores. ``gps-latlong.txt`` has a row for each position:
time, a number that says how it was found, latitude and longitude [degrees], height [m], and their
standard deviations. The specification here was what two programs read: mpkuse/
katwijk_dataset_to_rosbag (the names, the units, the lasers' elevations from 15 down to -15 degrees
and x = r cos cos, y = r cos sin) and plusk01/katwijk_tools (the time, the columns, and that
``gps-utm31.txt`` holds latitudes too).

Unverified, as nothing could be downloaded: the sense in which the azimuth turns, the place and the
turn of the LiDAR on the rover (give them with a mount file), and the clock's time zone, which is
taken as UTC in both kinds of files. The rover's heading is that of its track; its pitch and roll
are taken as 0.
"""

import re
from datetime import datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt16
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.georeference import check_place
from gpgrad_core.reading.images import read_grey_png
from gpgrad_core.reading.text import parse_numbers, split_rows
from gpgrad_core.recordings.params import BuildParams, PointFilter
from gpgrad_core.recordings.pose_files import PoseFile, positions_of, read_mount, read_timed_poses
from gpgrad_core.recordings.recording import (
    FoundPoses,
    FoundScans,
    Recording,
    RecordingSources,
    Scan,
    assemble,
    find_file,
)
from gpgrad_core.recordings.trajectory import Poses, Trajectory

FOLDER, POSITIONS = "Velodyne", ("gps-latlong.txt", "gps-utm31.txt")
LASERS, COLUMNS = 16, 1808
ELEVATIONS = np.radians(np.arange(15.0, -16.0, -2.0))
NAME = re.compile(r"Velodyne_(\d{4}(?:_\d{2}){5}_\d{3})_range\.png")
KINDS = ("range", "azimuth", "intensity")
STRIDE = 0.5
"""Distance on either side of a place from which its heading is found [m]."""
LEAST_WAY = 1.0
"""A traverse that is shorter has no heading [m]."""


def is_katwijk(path: Path) -> bool:
    """Whether a folder is a part of a traverse of Katwijk."""
    folder = path / FOLDER
    return folder.is_dir() and any(NAME.fullmatch(entry.name) for entry in folder.iterdir())


def open_katwijk(path: Path, sources: RecordingSources, params: BuildParams) -> Recording:
    """Open a part of a traverse; of poses that the sources name, its positions are the truth."""
    sources.refuse("a recording of Katwijk has its own times and truth", "truth", "times")
    scans = sorted(
        (name[1], entry)
        for entry in (path / FOLDER).iterdir()
        if (name := NAME.fullmatch(entry.name))
    )
    for _, file in scans:
        for kind in KINDS:
            if not _image(file, kind).is_file():
                raise InputError(f"{_image(file, kind)}: no such file; {file.name} needs it")
    stamps = np.array([_time(stamp, str(file)) for stamp, file in scans])
    positions = find_file([path], POSITIONS)
    measured = None if positions is None else read_places(positions)
    notes: tuple[str, ...] = ()
    truth = None
    if sources.poses is not None:
        trajectory = read_timed_poses(sources.poses)
        truth = measured
    elif positions is None or measured is None:
        raise InputError(f"{path}: has no {POSITIONS[0]}; say where the poses are: --poses FILE")
    else:
        trajectory = _along_track(measured.trajectory, positions)
        notes = (
            f"{positions.name}: its positions are used with the heading of the track; pitch and "
            "roll are taken as 0",
        )
    images = [tuple(_image(file, kind) for kind in KINDS) for _, file in scans]
    keep = PointFilter(sources.keep)

    def read_scan(k: int) -> Scan:
        triple = [read_grey_png(image, LASERS, COLUMNS) for image in images[k]]
        return Scan(points_of_images(*triple, keep=keep, where=str(scans[k][1])))

    level = "the LiDAR is taken to sit level at the antenna; say where it sits: --mount FILE"
    poses_of_scans = FoundPoses(
        trajectory,
        truth=truth,
        truth_name=str(positions),
        origin=None if measured is None else measured.origin,
        notes=(level,) if sources.mount is None else (),
    )
    return assemble(
        path,
        sources,
        params,
        FoundScans(
            labels=[file.name for _, file in scans],
            read=lambda numbers: map(read_scan, numbers),
            stamps=stamps,
            files=images,
            mount=None if sources.mount is None else read_mount(sources.mount).pose,
            keep=keep,
        ),
        poses_of_scans,
        texts=[sources.poses, positions, sources.mount],
        notes=notes,
    )


def _image(file: Path, kind: str) -> Path:
    return file.with_name(file.name.removesuffix("range.png") + f"{kind}.png")


def _time(text: str, where: str) -> float:
    """Read a time of the dataset [s since 1970]."""
    try:
        return datetime.strptime(f"{text} +0000", "%Y_%m_%d_%H_%M_%S_%f %z").timestamp()
    except ValueError:
        raise InputError(f"{where}: {text!r:.40} is no time year_month_day_h_m_s_ms") from None


def read_places(path: Path) -> PoseFile:
    """Read ``gps-latlong.txt`` as positions east, north and up of the first place."""
    stamps: list[float] = []
    places: list[list[float]] = []
    for where, words in split_rows(path, comment=None):
        if len(words) < 5:
            raise InputError(
                f"{where}: has {len(words)} columns; a position has 5 or more: time, kind, "
                "latitude, longitude, height"
            )
        stamps.append(_time(words[0], where))
        places.append(parse_numbers(words[2:5], where))
        check_place(places[-1], where)
    if len(stamps) < 2:
        raise InputError(f"{path}: holds {len(stamps)} positions; a track needs two or more")
    return positions_of(np.array(stamps), np.array(places))


def _along_track(track: Trajectory, path: Path) -> Trajectory:
    """Add the track's heading to positions: from half a metre before to half a metre after."""
    positions = track.poses.translation
    steps = np.linalg.norm(np.diff(positions[:, :2], axis=0), axis=1)
    # The noise of a standing receiver is no way: it is passed over in steps that are shorter.
    along = np.concatenate([[0.0], np.cumsum(np.where(steps < 0.01, 0.0, steps))])
    if along[-1] < LEAST_WAY:
        raise InputError(f"{path}: is {along[-1]:.2f} m long; a heading needs a track of 1 m")
    ahead, behind = (
        np.column_stack([np.interp(along + way, along, positions[:, k]) for k in range(2)])
        for way in (STRIDE, -STRIDE)
    )
    way = ahead - behind
    yaw = np.arctan2(way[:, 1], way[:, 0])
    turns = Rotation.from_euler("z", yaw[:, None])
    return Trajectory.in_order(track.stamps, Poses(positions, turns))


def points_of_images(
    ranges: UInt16[NDArray[np.uint16], "16 columns"],
    azimuth: UInt16[NDArray[np.uint16], "16 columns"],
    intensity: UInt16[NDArray[np.uint16], "16 columns"],
    keep: PointFilter,
    where: str,
) -> Float[Array, "n 3"]:
    """Turn images of ranges [mm], azimuths [0.01 degrees] and intensities into points [m]."""
    returned = ranges > 0
    if (azimuth[returned] > 36_000).any():
        raise InputError(
            f"{where}: an azimuth is {azimuth[returned].max() / 100:g} degrees; 360 is the most"
        )
    numbers = {
        "range": 0.001 * ranges[returned].astype(np.float64),
        "azimuth": 0.01 * azimuth[returned].astype(np.float64),
        "intensity": intensity[returned].astype(np.float64),
    }
    elevation = np.broadcast_to(ELEVATIONS[:, None], ranges.shape)[returned]
    turn = np.radians(numbers["azimuth"])
    level = numbers["range"] * np.cos(elevation)
    points = np.column_stack(
        [level * np.cos(turn), level * np.sin(turn), numbers["range"] * np.sin(elevation)]
    )
    return keep.select(points, numbers.get, where)
