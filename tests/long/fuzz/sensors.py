"""Bags of cameras and of Livox: damaged anywhere, or in a field of one of their messages."""

import random
import struct
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gpgrad_core.recordings.build import open_recording
from gpgrad_core.recordings.recording import Scan
from tests.long.fuzz.mutation import WORDS, Case, at_random, cut
from tests.support.bags import BagWriter

SENSORS = ("pairs", "packed pairs", "depths", "packed depths", "livox")
STORAGES = ("ros1", "mcap", "sqlite3")
COUNT = 3
"""Scans of a bag."""
WIDTH, HEIGHT = 40, 24
FRAME = "camera"
NOT_WHOLE = (0, 1, WIDTH - 1, 2**31, 2**32 - 1)
WRONG: dict[str, dict[str, tuple[Any, ...]]] = {
    "Image": {
        "width": (*NOT_WHOLE, WIDTH + 1),
        "height": (*NOT_WHOLE, HEIGHT + 1),
        "step": (4 * WIDTH + 1, 2**32 - 1),
        "encoding": ("", "yuv422", "mono8 ", "a" * 300),
        "data": (np.zeros(0, np.uint8), np.zeros(WIDTH - 1, np.uint8)),
    },
    "CompressedImage": {
        "data": (np.zeros(0, np.uint8), np.zeros(99, np.uint8), np.frombuffer(b"\xff\xd8", "u1")),
    },
    "CameraInfo": {
        "width": NOT_WHOLE,
        "height": NOT_WHOLE,
        "distortion_model": ("fov", "a" * 300),
        "d": tuple(np.full(number, 0.1) for number in (1, 3, 6, 99)),
        "k": tuple(np.full(9, value) for value in (0.0, np.nan, np.inf, 1e300, 1e-300, 1.0)),
        "p": tuple(np.full(12, value) for value in (np.nan, np.inf, 1e300, 1e-300, 1.0)),
        "r": tuple(np.full(9, value) for value in (np.nan, 1.0, 1e300)),
    },
}
"""Values of fields that must be refused, by the type of the message."""
NUMBERS = (0.0, -1.0, 1e-300, 1e5, 1e30, 3e38, float("nan"), float("inf"))
WHOLE = (0, 1, 2, 127, 255)

Spoil = Callable[[str, Any], Any]


class _Writer(BagWriter):
    def __init__(self, path: Path, storage: str, spoil: Spoil) -> None:
        super().__init__(path, ros1=storage == "ros1", storage=storage)
        self.spoil = spoil

    def write(self, topic: str, kind: str, stamp: float, message: Any) -> None:
        super().write(topic, kind, stamp, self.spoil(kind.rsplit("/", maxsplit=1)[-1], message))


def _nothing(_kind: str, message: Any) -> Any:
    return message


def _made(sensor: str, storage: str, spoil: Spoil = _nothing) -> Case:
    """Write a bag, and give its file."""
    import cv2  # noqa: PLC0415 - loads slowly
    from scipy.spatial.transform import Rotation  # noqa: PLC0415

    from gpgrad_core.recordings.trajectory import Poses  # noqa: PLC0415

    rng = np.random.default_rng(0)
    mount = Poses(np.array([[0.0, 0.0, 1.0]]), Rotation.from_euler("x", [[-2.0]]))
    body = Poses(np.arange(3.0 * COUNT).reshape(COUNT, 3), Rotation.identity(COUNT))
    p = np.array([[50.0, 0, 20, 0], [0, 50, 12, 0], [0, 0, 1, 0]])
    size = WIDTH, HEIGHT
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / ("a.bag" if storage == "ros1" else "a")
        with _Writer(path, storage, spoil) as bag:
            bag.transform(1.0, "base_link", FRAME, mount, 0, topic="/tf_static")
            if sensor != "livox":
                for side, shift in (("left", 0.0), ("right", -5.0)):
                    moved = p + shift * np.eye(3, 4, 3)
                    bag.camera(f"/{side}/camera_info", 1.0, FRAME, size, moved, model="plumb_bob")
            for k in range(COUNT):
                stamp = 1.0 + k
                bag.odometry("/odom", stamp, body, k)
                wide = rng.integers(0, 255, (HEIGHT, WIDTH + 4), np.uint8)
                depths = wide[:, :WIDTH].astype(np.uint16) + 500
                match sensor:
                    case "pairs":
                        bag.image("/left/image_rect", stamp, FRAME, wide[:, :WIDTH], "mono8")
                        bag.image("/right/image_rect", stamp, FRAME, wide[:, 4:], "mono8")
                    case "packed pairs":
                        for side, first in (("left", 0), ("right", 4)):
                            image = wide[:, first : first + WIDTH]
                            content = cv2.imencode(".png", image)[1].tobytes()
                            topic = f"/{side}/image_raw/compressed"
                            bag.packed(topic, stamp, FRAME, content, "mono8; png compressed")
                    case "depths":
                        bag.image("/left/image_raw", stamp, FRAME, depths, "16UC1")
                    case "packed depths":
                        content = struct.pack("<i2f", 0, 0.0, 0.0)
                        content += cv2.imencode(".png", depths)[1].tobytes()
                        topic = "/left/image_raw/compressedDepth"
                        bag.packed(topic, stamp, FRAME, content, "16UC1; compressedDepth png")
                    case _:
                        bag.livox(
                            "/livox", stamp, FRAME, rng.normal(size=(9, 3)), "livox_ros_driver"
                        )
        file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
        return Case(file.read_bytes(), "nothing", damaged=False, ending=file.suffix, sound=True)


_sound = cache(_made)


def bag_of_sensor(rng: random.Random) -> Case:
    """A bag of a sensor."""
    sensor = rng.choice(SENSORS)
    how = rng.choice(("cut", "bytes", "wrong", "odd", "odd"))
    if how == "cut":
        whole = _sound(sensor, rng.choice(STORAGES))
        return replace(cut(rng, whole.content, len(whole.content) // 20), ending=whole.ending)
    if how == "bytes":
        whole = _sound(sensor, rng.choice(STORAGES))
        return replace(at_random(rng, whole.content), ending=whole.ending)
    if sensor == "livox":
        how = "odd"
    kinds = {
        "pairs": ("Image", "CameraInfo"), "packed pairs": ("CompressedImage", "CameraInfo"),
        "depths": ("Image", "CameraInfo"), "packed depths": ("CompressedImage", "CameraInfo"),
        "livox": ("CustomMsg", "Odometry"),
    }[sensor]  # fmt: skip
    chosen, left, what = rng.choice(kinds), rng.randrange(COUNT), [how]
    if chosen == "CameraInfo":
        left = 0 if "depths" in sensor else rng.randrange(2)

    def spoil(kind: str, message: Any) -> Any:
        nonlocal left
        if kind != chosen:
            return message
        left -= 1
        if left != -1:
            return message
        if how == "odd":
            return _odd(rng, message, what)
        name = rng.choice(list(WRONG[kind]))
        what.append(name)
        value = rng.choice(WRONG[kind][name])
        held = name if hasattr(message, name) else name.upper()
        return replace(message, **{held: value})

    made = _made(sensor, rng.choice(STORAGES[:2]), spoil)
    return replace(made, what=" ".join([*what, "of", chosen]), damaged=how == "wrong", sound=False)


def _odd(rng: random.Random, message: Any, what: list[str]) -> Any:
    """Replace a field of a message, or of a message in it, by something odd of its type."""
    names = [name for name in vars(message) if not name.startswith("__")]
    arrays = [name for name in names if isinstance(getattr(message, name), np.ndarray)]
    name = rng.choice(arrays if arrays and rng.random() < 0.5 else names)
    what.append(name)
    value = getattr(message, name)
    if isinstance(value, str):
        odd: Any = rng.choice([word for word in WORDS if len(word) < 400])
    elif isinstance(value, float):
        odd = rng.choice(NUMBERS)
    elif isinstance(value, bool | int):
        odd = rng.choice((*WHOLE, 2**31 - 1)) if name in ("sec", "width", "height") else 0
        odd = rng.choice(WHOLE) if odd == 0 else odd
    elif isinstance(value, np.ndarray):
        odd = value.copy()
        drawn = rng.choice(WHOLE if value.dtype == np.uint8 else NUMBERS)
        odd[rng.randrange(len(odd))] = drawn
    elif isinstance(value, list):
        k = rng.randrange(len(value))
        odd = [*value[:k], _odd(rng, value[k], what), *value[k + rng.randrange(2) :]]
    else:
        odd = _odd(rng, value, what)
    return replace(message, **{name: odd})


def read_bag_of_sensor(path: Path) -> list[Scan]:
    """Read all scans; none of them may be left out without a word."""
    recording = open_recording(path)
    if len(recording) < COUNT and not recording.notes:
        raise AssertionError(f"{len(recording)} of {COUNT} scans, and no note")
    return list(recording.read(0, len(recording)))
