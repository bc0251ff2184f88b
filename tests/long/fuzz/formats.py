"""Every format that gpgrad reads: how to damage a file of it, and how it is read."""

import random
import shutil
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from app.viewer.features.data.unpacking import unpack
from app.viewer.session.session_file import read_session
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import read_problems
from gpgrad_core.io.clouds import CLOUD_FORMATS, load_cloud
from gpgrad_core.io.clouds.format import CloudFormat
from gpgrad_core.io.dataset_toml import read_dataset_toml
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.io.poses import read_matrix_pose, read_poses
from gpgrad_core.io.rasters import read_elevation_model
from gpgrad_core.io.records.closures import read_closures, restore_closures
from gpgrad_core.params import preferred_parameters, read_parameters
from gpgrad_core.reading.images import read_grey_png, read_images
from gpgrad_core.recordings.build import open_recording
from gpgrad_core.recordings.cameras import read_camera, read_kitti_cameras
from gpgrad_core.recordings.katwijk import read_places
from gpgrad_core.recordings.pds import read_places_table
from gpgrad_core.recordings.pose_files import (
    read_mount,
    read_pose_file,
    read_times,
    read_truth_file,
)
from gpgrad_core.slam import read_graph
from gpgrad_core.types import Dataset
from tests.long.fuzz import clouds, live, packed, sensors, texts
from tests.long.fuzz.mutation import Case, Mutator, at_random

MOST_UNPACKED = 8_000_000
CAMERA = (
    b"width: 640\nheight: 480\ndistortion_model: radtan\nD: [-0.2, 0.1, 1e-3, 0.0]\n"
    b"T_BS:\n  rows: 4\n  data: [1, 0, 0, 0.5,\n  0, 1, 0, 0, 0, 0, 1, 0]\n"
    b"K: [500.0, 0, 320, 0, 500, 240, 0, 0, 1]\nR: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
)
CAMERAS = b"P0: 7e2 0 600 0 0 7e2 170 0 0 0 1 0\nP1: 7e2 0 600 -386.1 0 7e2 170 0 0 0 1 0\n"
SECONDS = 10.0
"""Longest that a file may take."""

Outcome = Literal["refused", "accepted", "silent", "lost", "foreign", "over"]


@dataclass(frozen=True)
class Format:
    """How files of a format are damaged and read.

    Attributes:
        ending: Of the file's name.
        mutate: Makes a damaged file.
        read: Reads it.
        share: How many files of it are tried, relative to other formats; a process for each file
            takes its time.
        name: Of the file, where messages call it by its only name.
    """

    ending: str
    mutate: Mutator
    read: Callable[[Path], object]
    share: float = 1.0
    name: str = ""


def _read_about(path: Path) -> object:
    info = read_dataset_toml(path, frozenset({"000", "001"}))
    dataset = Dataset("hills", (), preferred=info.preferred)
    return preferred_parameters(dataset, PipelineParams())


def _read_archive(path: Path) -> object:
    folder = path.with_name("unpacked")
    try:
        found, _ = unpack(path.name, path.read_bytes(), folder, MOST_UNPACKED)
        return load_dataset(found)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _read_bag(path: Path) -> object:
    recording = open_recording(path)
    return list(recording.read(0, len(recording)))


def _read_model(path: Path) -> object:
    """Read an elevation model, and compare it with what GDAL reads."""
    model = read_elevation_model(path)
    import rasterio  # noqa: PLC0415 (only where elevation models are fuzzed)

    with warnings.catch_warnings(action="ignore"), rasterio.open(path) as file:
        values = file.read(1, masked=True).astype(float).filled(np.nan)[::-1]
        cell = file.res
    values[~(np.abs(values) < 1e5)] = np.nan
    np.testing.assert_array_equal(model.heights, values)
    np.testing.assert_allclose(model.cell, cell, rtol=1e-9)
    return model


def _cloud(cloud_format: CloudFormat) -> Format:
    """Damage clouds as their format's own mutator does, or else an example anywhere."""

    def anywhere(rng: random.Random) -> Case:
        return at_random(rng, cloud_format.example)

    ending = cloud_format.ending
    share = 0.5 if ending == ".laz" else 1.0
    return Format(ending, clouds.MUTATORS.get(ending, anywhere), load_cloud, share)


FORMATS: dict[str, Format] = {
    **{ending[1:]: _cloud(cloud_format) for ending, cloud_format in CLOUD_FORMATS.items()},
    "poses": Format(
        ".txt", texts.poses, lambda path: read_poses(path, dict.fromkeys(range(3), ""))
    ),
    "trajectory": Format(".txt", texts.trajectory, read_pose_file),
    "times": Format(".txt", texts.times, read_times),
    "positions": Format(".txt", texts.positions, read_truth_file),
    "solution": Format(".pos", texts.solution, read_truth_file),
    "katwijk": Format(".txt", texts.katwijk, read_places),
    "places": Format(".csv", texts.places_table, read_places_table),
    "png16": Format(".png", packed.grey, lambda path: read_grey_png(path, 3, 5)),
    "camera": Format(".yaml", lambda rng: at_random(rng, CAMERA), read_camera),
    "cameras": Format(
        ".txt", lambda rng: at_random(rng, CAMERAS), lambda path: read_kitti_cameras(path, (0, 1))
    ),
    "mount": Format(".txt", texts.mount, read_mount),
    "gt": Format(".gt", texts.matrix, read_matrix_pose),
    "problems": Format(".txt", texts.problems, read_problems),
    "g2o": Format(".g2o", texts.g2o, read_graph),
    "about": Format(".toml", texts.about, _read_about, name="dataset.toml"),
    "params": Format(".toml", texts.params, lambda path: read_parameters(path, PipelineParams())),
    "session": Format(".toml", texts.session, read_session),
    "closures": Format(".json", texts.closures, lambda path: restore_closures(read_closures(path))),
    "zip": Format(".zip", packed.archive, _read_archive),
    "image": Format(".png", packed.image, lambda path: list(read_images([path])), share=0.2),
    "tif": Format(".tif", packed.geotiff, _read_model, share=0.5),
    "bag": Format(".bag", packed.bag, _read_bag, share=0.3),
    "run": Format(".gpgrad", live.record, live.read_record),
    "frames": Format(".frames", live.frames, live.read_frames),
    "socket": Format(".frames", live.frames, live.read_socket),
    "sensors": Format(".bag", sensors.bag_of_sensor, sensors.read_bag_of_sensor, share=0.3),
}


@dataclass(frozen=True)
class Result:
    """What came of a file."""

    outcome: Outcome
    what: str
    said: str
    seconds: float


def make_case(name: str, seed: int, number: int) -> Case:
    """Make a damaged file; the same arguments make the same file."""
    return FORMATS[name].mutate(random.Random(f"{name}/{seed}/{number}"))


def try_case(name: str, case: Case, folder: Path) -> Result:
    """Read a damaged file, and say what came of it."""
    path = folder / (FORMATS[name].name or f"000{case.ending or FORMATS[name].ending}")
    path.write_bytes(case.content)
    begin = time.process_time()
    try:
        FORMATS[name].read(path)
        outcome, said = ("silent" if case.damaged else "accepted"), ""
    except InputError as error:
        said = str(error)
        # One line that names the file.
        outcome = "refused" if "\n" not in said and path.name in said else "foreign"
        if case.sound:
            outcome = "lost"
    except (MemoryError, TimeoutError) as error:
        outcome, said = "over", repr(error)
    except Exception as error:  # which is what is looked for
        place = traceback.extract_tb(error.__traceback__)[-1]
        outcome, said = "foreign", f"{error!r:.200} at {place.filename}:{place.lineno}"
    seconds = time.process_time() - begin
    path.unlink()
    if seconds > SECONDS:
        outcome = "over"
    return Result(outcome, case.what, said, seconds)
