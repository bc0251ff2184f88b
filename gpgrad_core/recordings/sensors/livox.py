"""Livox's own messages, of either of its drivers -> scans.

A ``CustomMsg`` has a list of ``CustomPoint``, each with its x, y and z [m] in the sensor's frame,
reflectivity, tag, line and the time since the first one [ns]. Points of a scan that takes 0.1 s are
placed together, at the pose of the message's time.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from gpgrad_core.arrays import NDArray
from gpgrad_core.recordings.params import kept_points
from gpgrad_core.recordings.recording import Scan
from gpgrad_core.recordings.sensors.sensor import Bag, Decode, Message, Sensor, each_topic

PACKAGES = ("livox_ros_driver", "livox_ros_driver2")
POINT = (
    "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\n"
    "uint8 line\n"
)
CLOUD = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
    "CustomPoint[] points\n"
)
TYPES = tuple(f"{package}/msg/CustomMsg" for package in PACKAGES)
DEFINITIONS = {
    f"{package}/msg/{name}": text
    for package in PACKAGES
    for name, text in (("CustomPoint", POINT), ("CustomMsg", CLOUD))
}


def _open(bag: Bag, _topics: tuple[str, ...]) -> Decode:
    def decode(messages: Sequence[tuple[Message, ...]], where: Sequence[str]) -> Iterator[Scan]:
        for (message,), place in zip(messages, where, strict=True):
            seen = message.points

            def values_of(name: str, seen: Message = seen) -> NDArray[np.float64] | None:
                if name not in ("x", "y", "z", "offset_time", "reflectivity", "tag", "line"):
                    return None
                return np.array([getattr(point, name) for point in seen], np.float64)

            points = np.array([[point.x, point.y, point.z] for point in seen], np.float32)
            points = points.reshape(-1, 3)
            # The driver puts what has no return at the origin.
            returned = points.any(axis=1)
            mask = kept_points(bag.sources.keep, values_of, place, bag.tally)
            yield Scan(points[returned if mask is None else returned & mask])

    return decode


LIVOX = Sensor("clouds", TYPES, each_topic(*TYPES), _open, DEFINITIONS)
