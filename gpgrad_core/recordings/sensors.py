"""What may see the ground in a bag: kinds of sensors, whose messages become scans.

Of depth images (``16UC1`` [mm] or ``32FC1`` [m]), 0 and NaN are no depth. How uncertain they are is
not in the messages: the noise is measured from the scatter, as for a LiDAR. Points of a scan of
Livox that takes 0.1 s are placed together, at the pose of the message's time.
"""

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, UInt8

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.reading.decoding import MAX_PIXELS
from gpgrad_core.reading.images import decode_grey, decode_grey_png
from gpgrad_core.recordings.cameras import CameraModel, camera_of, read_camera
from gpgrad_core.recordings.params import BuildParams, PointFilter
from gpgrad_core.recordings.recording import RecordingSources, Scan
from gpgrad_core.recordings.stereo import NO_MATCH, make_rig
from gpgrad_core.recordings.trajectory import Poses

Message: TypeAlias = Any
"""A message, or a part of one; rosbags makes its types while it runs."""
Grey: TypeAlias = UInt8[NDArray[np.uint8], "rows columns"]
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
FORMS = {
    "mono8": ("u1", 1), "8UC1": ("u1", 1), "8UC3": ("u1", 3), "mono16": ("u2", 1),
    "rgb8": ("u1", 3), "bgr8": ("u1", 3), "rgba8": ("u1", 4), "bgra8": ("u1", 4),
    "16UC1": ("u2", 1), "32FC1": ("f4", 1), "bayer_rggb8": ("u1", 1), "bayer_bggr8": ("u1", 1),
    "bayer_gbrg8": ("u1", 1), "bayer_grbg8": ("u1", 1),
}  # fmt: skip
"""NumPy's type, and the number of values of a pixel, by the name of the encoding."""
DEPTHS = ("16UC1", "32FC1")
DEPTH_HEAD = struct.Struct("<i2f")
"""What image_transport puts before a compressed depth image: its format, and two numbers."""
Decode: TypeAlias = Callable[[Sequence[tuple[Message, ...]], Sequence[str]], Iterator[Scan]]
"""Makes scans of as many tuples of messages, one from each topic; the texts name them in errors."""
CLOUD, INFO = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo"
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's types by the numbers that PointCloud2 uses for them."""
LIVOX_POINT = (
    "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\n"
    "uint8 line\n"
)
LIVOX_CLOUD = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
    "CustomPoint[] points\n"
)
DEFINITIONS = {
    f"livox_ros_driver{driver}/msg/{name}": text
    for driver in ("", "2")
    for name, text in (("CustomPoint", LIVOX_POINT), ("CustomMsg", LIVOX_CLOUD))
}
"""Text of the types of messages that rosbags does not know, by their names."""
LIVOX_CLOUDS = tuple(name for name in DEFINITIONS if name.endswith("CustomMsg"))
TRANSPORTS = ("compressedDepth", "compressed")
"""Last parts of topics' names that say how images are packed."""
SIDES = (
    ("left", "right"),
    ("infra1", "infra2"),
    ("cam0", "cam1"),
    ("camera0", "camera1"),
    ("image_0", "image_1"),
)
"""How the left and the right one of two topics are called."""


@dataclass(frozen=True, eq=False)
class Bag:
    """What a sensor may ask of a bag."""

    path: Path
    topics: Mapping[str, str]  # type of the messages of each topic, by its name
    peek: Callable[[str], Message | None]  # gives the first message of a topic; None if it has none
    # gives the fixed ``T_target_source`` of two frames; None if no transforms join them
    between: Callable[[str, str], Poses | None]
    sources: RecordingSources
    params: BuildParams
    keep: PointFilter

    def of_type(self, *kinds: str) -> list[str]:
        return sorted(topic for topic, kind in self.topics.items() if kind in kinds)


@dataclass(frozen=True)
class Sensor:
    """A kind of sensor."""

    what: str  # what its messages are called in messages to people
    messages: tuple[str, ...]  # the types of messages that it may need
    # finds the topics of each such sensor in a bag; the first one has its frame
    find: Callable[[Bag], list[tuple[str, ...]]]
    # makes the function that decodes the messages of some topics
    open: Callable[[Bag, tuple[str, ...]], Decode]
    batch: int = 1  # number of scans that are decoded at a time
    advice: str = ""  # what may be wrong if no scan has any points


def _topics_of(*kinds: str) -> Callable[[Bag], list[tuple[str, ...]]]:
    return lambda bag: [(topic,) for topic in bag.of_type(*kinds)]


def _one_by_one(read: Callable[[Message, str], Scan]) -> Decode:
    def decode(messages: Sequence[tuple[Message, ...]], where: Sequence[str]) -> Iterator[Scan]:
        for (message,), place in zip(messages, where, strict=True):
            yield read(message, place)

    return decode


def _open_clouds(bag: Bag, _topics: tuple[str, ...]) -> Decode:
    return _one_by_one(lambda message, where: Scan(_points_of(message, where, bag.keep)))


def _points_of(
    message: Message, where: str, keep: PointFilter
) -> Float[NDArray[np.floating], "n 3"]:
    """Read x, y and z [m] of each point that meets all conditions on any fields, NaN too."""
    fields = {field.name: field for field in message.fields}
    names = list(dict.fromkeys([*"xyz", *(condition.field for condition in keep.conditions)]))
    missing = [name for name in names if name not in fields]
    if missing:
        lacking, held = " or ".join(missing), ", ".join(fields) or "nothing"
        raise InputError(f"{where}: its points have no field {lacking}, only {held}")
    twice = [name for name in names if [field.name for field in message.fields].count(name) > 1]
    if twice:
        raise InputError(
            f"{where}: its points have two fields {twice[0]}; give each field a name of its own"
        )
    wrong = [name for name in names if fields[name].datatype not in NUMBERS]
    if wrong:
        what = "x, y and z do" if wrong[0] in "xyz" else f"{wrong[0]} does"
        raise InputError(f"{where}: {what} not have a number type of PointCloud2")
    whole = [name for name in "xyz" if NUMBERS[fields[name].datatype][0] != "f"]
    if whole:
        raise InputError(
            f"{where}: its {', '.join(whole)} are whole numbers, of which nothing says the unit; "
            "convert x, y and z to FLOAT32 in metres"
        )
    order = ">" if message.is_bigendian else "<"
    formats = [np.dtype(order + NUMBERS[fields[name].datatype]) for name in names]
    offsets = [int(fields[name].offset) for name in names]
    rows, columns, size = int(message.height), int(message.width), int(message.point_step)
    if rows * columns == 0:
        return np.empty((0, 3))
    data = np.asarray(message.data, np.uint8)
    # Where the rows have no padding, some drivers leave row_step at 0, or give the whole size.
    packed = rows == 1 or len(data) == rows * columns * size
    step = columns * size if packed else max(int(message.row_step), columns * size)
    end = max(start + kind.itemsize for start, kind in zip(offsets, formats, strict=True))
    if end > size:
        raise InputError(f"{where}: its fields end at byte {end} of a point, which has {size}")
    if len(data) < (rows - 1) * step + columns * size:
        apart = "" if packed else f" in {rows:,} rows that begin {step:,} bytes apart (row_step)"
        raise InputError(
            f"{where}: is cut short: it should hold {rows * columns:,} points of "
            f"{size} bytes{apart}, but it holds {len(data):,} bytes"
        )
    layout = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
    table = np.ndarray((rows, columns), layout, data.tobytes(), strides=(step, size)).ravel()

    def values_of(name: str) -> NDArray[np.float64]:
        return table[name].astype(np.float64)

    table = keep.select(table, values_of, where)
    points = np.column_stack([table[name] for name in "xyz"])
    return points.astype(np.float64 if points.dtype.itemsize > 4 else np.float32)


def _open_livox(bag: Bag, _topics: tuple[str, ...]) -> Decode:
    def read(message: Message, where: str) -> Scan:
        def values_of(name: str) -> NDArray[np.float64] | None:
            if name not in ("x", "y", "z", "offset_time", "reflectivity", "tag", "line"):
                return None
            return np.array([getattr(point, name) for point in message.points], np.float64)

        points = np.array([[point.x, point.y, point.z] for point in message.points], np.float32)
        points = bag.keep.select(points.reshape(-1, 3), values_of, where)
        return Scan(points[points.any(axis=1)])  # the driver puts what has no return at the origin

    return _one_by_one(read)


def _find_depths(bag: Bag) -> list[tuple[str, ...]]:
    images = bag.of_type(IMAGE, COMPRESSED)
    return [(t,) for t in images if (first := bag.peek(t)) is not None and _is_depth(first)]


def _open_depths(bag: Bag, topics: tuple[str, ...]) -> Decode:
    bag.sources.refuse("depth images have x, y and z only", "keep")
    (camera,) = _cameras_of(bag, topics)
    rays = camera.rays(rectified=_is_rectified(topics[0]))

    def read(message: Message, where: str) -> Scan:
        z = _depths(message, camera, where)
        valid = np.isfinite(z) & (z > 0)
        return Scan(np.column_stack([rays[valid] * z[valid][:, None], z[valid]]))

    return _one_by_one(read)


def _find_pairs(bag: Bag) -> list[tuple[str, ...]]:
    images = bag.of_type(IMAGE, COMPRESSED)
    left, right = bag.sources.cloud_topic, bag.sources.right_topic
    if right is not None:
        for topic in (left, right):
            if topic not in images:
                named = ", ".join(images) or "none"
                raise InputError(
                    f"{bag.path}: {topic}: is not a topic of images there; --cloud-topic and "
                    f"--right-topic name those of the left and the right camera; it has {named}"
                )
        assert left is not None
        return [(left, right)]
    pairs = (
        (topic, topic.replace(one, other))
        for topic in images
        for one, other in SIDES
        if one in topic and topic.replace(one, other) in images
    )
    return [
        pair
        for pair in dict.fromkeys(pairs)
        if all((m := bag.peek(topic)) is not None and not _is_depth(m) for topic in pair)
    ]


def _open_pairs(bag: Bag, topics: tuple[str, ...]) -> Decode:
    bag.sources.refuse("image pairs have x, y and z only", "keep")
    left, right = _cameras_of(bag, topics)
    first = [bag.peek(topic) for topic in topics]
    frames = [str(message.header.frame_id) for message in first if message is not None]
    between = None if frames[0] == frames[1] else bag.between(*frames)
    rig = make_rig(left, right, between, rectified=_is_rectified(topics[0]))

    def decode(messages: Sequence[tuple[Message, ...]], where: Sequence[str]) -> Iterator[Scan]:
        both = [message for pair in messages for message in pair]
        images = iter(_grey_images(both, [place for place in where for _ in topics]))
        for place, one, other in zip(where, images, images, strict=True):
            yield rig.scan(one, other, place, bag.params.min_range)

    return decode


def _encoding_of(message: Message) -> str:
    """The encoding of an image's values; that of a compressed one if it says so, else ""."""
    if hasattr(message, "encoding"):
        return str(message.encoding)
    return str(message.format).split(";", 1)[0].strip()


def _is_depth(message: Message) -> bool:
    packed_otherwise = "compressedDepth" not in getattr(message, "format", "compressedDepth")
    return not packed_otherwise and _encoding_of(message) in DEPTHS


def _grey_images(messages: Sequence[Message], where: Sequence[str]) -> list[Grey]:
    packed = [hasattr(message, "format") for message in messages]
    chosen = [k for k, is_packed in enumerate(packed) if is_packed]
    contents = [np.asarray(messages[k].data, np.uint8).tobytes() for k in chosen]
    unpacked = dict(zip(chosen, decode_grey(contents, [where[k] for k in chosen]), strict=True))
    return [
        unpacked[k] if k in unpacked else _grey(message, where[k])
        for k, message in enumerate(messages)
    ]


def _grey(message: Message, where: str) -> Grey:
    import cv2  # noqa: PLC0415 - loads slowly

    values: Any = _raw_values(message, where)
    encoding = str(message.encoding)
    if encoding.startswith("bayer_"):
        code = getattr(cv2, f"COLOR_Bayer{encoding[6:10].upper()}2GRAY")
        return cv2.cvtColor(values, code)
    if values.ndim == 3:
        first = "RGB" if encoding.startswith("rgb") else "BGR"
        alpha = "A" if values.shape[2] == 4 else ""
        return cv2.cvtColor(values, getattr(cv2, f"COLOR_{first}{alpha}2GRAY"))
    if values.dtype != np.uint8:
        if encoding in DEPTHS:
            raise InputError(f"{where}: holds depths ({encoding}), not an image of a camera")
        # Cameras of 10 or 12 bits leave the upper ones empty; matching looks at contrasts only.
        return (values / max(int(values.max(initial=0)) / 255.0, 1.0)).astype(np.uint8)
    return values


def _raw_values(message: Message, where: str) -> NDArray[np.generic]:
    """The values of an ``Image`` (rows, columns) or (rows, columns, channels)."""
    encoding = str(message.encoding)
    if encoding not in FORMS:
        raise InputError(f"{where}: its encoding is {encoding:.40}; known are {', '.join(FORMS)}")
    kind, channels = FORMS[encoding]
    rows, columns = int(message.height), int(message.width)
    if rows * columns > MAX_PIXELS:
        raise InputError(f"{where}: has over {MAX_PIXELS:,} pixels")
    type_ = np.dtype((">" if message.is_bigendian else "<") + kind)
    least = columns * channels * type_.itemsize
    step = max(int(message.step), least)
    data = np.asarray(message.data, np.uint8)
    if len(data) < rows * step or rows * columns == 0:
        raise InputError(
            f"{where}: is cut short: {rows} rows of {step} bytes, but it holds {len(data):,} bytes"
        )
    table = np.ascontiguousarray(data[: rows * step].reshape(rows, step)[:, :least])
    values = table.view(type_).reshape(rows, columns, channels)
    values = values.astype(type_.newbyteorder("="), copy=False)
    return values[:, :, 0] if channels == 1 else values


def _depths(message: Message, camera: CameraModel, where: str) -> NDArray[np.float32]:
    """The depth of each pixel [m]; 0 or NaN where there is none."""
    encoding = _encoding_of(message)
    if encoding not in DEPTHS:
        raise InputError(f"{where}: its encoding is {encoding:.40}, not {' or '.join(DEPTHS)}")
    if not hasattr(message, "format"):
        values = _raw_values(message, where)
    else:
        content = np.asarray(message.data, np.uint8).tobytes()
        if len(content) < DEPTH_HEAD.size:
            raise InputError(f"{where}: is cut short: it holds {len(content)} bytes")
        columns, rows = camera.size
        values = decode_grey_png(content[DEPTH_HEAD.size :], rows, columns, where)
        if encoding == "32FC1":
            # image_transport stores inverse depths, as a / depth + b.
            _, a, b = DEPTH_HEAD.unpack_from(content)
            with np.errstate(divide="ignore", invalid="ignore"):
                inverted = np.float32(a) / (values.astype(np.float32) - np.float32(b))
            values = np.where(values > 0, inverted, np.float32(np.nan))
    camera.check_image(values, where)
    scale = np.float32(0.001 if encoding == "16UC1" else 1.0)
    return values.astype(np.float32) * scale


def _is_rectified(topic: str) -> bool:
    """Whether images are rectified, by the name of their topic, as in ROS."""
    return "rect" in _raw_topic(topic).rsplit("/", 1)[-1]


def _raw_topic(topic: str) -> str:
    parts = topic.rsplit("/", 1)
    return parts[0] if parts[-1] in TRANSPORTS else topic


def _cameras_of(bag: Bag, topics: Sequence[str]) -> list[CameraModel]:
    """Find the calibration of each topic of images: files of the sources, or ``CameraInfo``."""
    files = bag.sources.calibration
    if files:
        if len(files) != len(topics):
            raise InputError(
                f"--calibration {files[0]}: {len(topics)} cameras need as many files, got "
                f"{len(files)}"
            )
        return [read_camera(path) for path in files]
    cameras: list[CameraModel] = []
    for topic in topics:
        beside = f"{_raw_topic(topic).rsplit('/', 1)[0]}/camera_info"
        info = bag.peek(beside) if bag.topics.get(beside) == INFO else None
        if info is None:
            raise InputError(
                f"{bag.path}: {topic} has no calibration: there is no CameraInfo on {beside}; give "
                "a file for each camera: --calibration FILE"
            )
        cameras.append(camera_of(info, f"{bag.path}, {beside}"))
    return cameras


STEREO_PAIR = Sensor(
    "image pairs", (IMAGE, COMPRESSED), _find_pairs, _open_pairs, batch=8, advice=NO_MATCH
)
SENSORS = (
    Sensor("clouds", (CLOUD,), _topics_of(CLOUD), _open_clouds),
    Sensor("clouds", LIVOX_CLOUDS, _topics_of(*LIVOX_CLOUDS), _open_livox),
    Sensor("depth images", (IMAGE, COMPRESSED), _find_depths, _open_depths),
    STEREO_PAIR,
)
"""By priority."""
