"""Depth images with their calibration -> scans in the frame of the camera.

Depths are ``16UC1`` [mm] or ``32FC1`` [m], as they are or compressed by ``compressedDepth``; 0 and
NaN are no depth. How uncertain they are is not in the messages: the noise is measured from the
scatter, as for a LiDAR.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from gpgrad_core.recordings.recording import Scan
from gpgrad_core.recordings.sensors.images import (
    COMPRESSED,
    IMAGE,
    cameras_of,
    depths,
    is_depth,
    is_rectified,
)
from gpgrad_core.recordings.sensors.sensor import Bag, Decode, Message, Sensor


def _find(bag: Bag) -> list[tuple[str, ...]]:
    images = bag.of_type((IMAGE, COMPRESSED))
    return [(t,) for t in images if (first := bag.peek(t)) is not None and is_depth(first)]


def _open(bag: Bag, topics: tuple[str, ...]) -> Decode:
    bag.sources.refuse("depth images have x, y and z only", "keep")
    (camera,) = cameras_of(bag, topics)
    rays = camera.rays(rectified=is_rectified(topics[0]))

    def decode(messages: Sequence[tuple[Message, ...]], where: Sequence[str]) -> Iterator[Scan]:
        for (message,), place in zip(messages, where, strict=True):
            z = depths(message, camera, place)
            seen = np.isfinite(z) & (z > 0)
            yield Scan(np.column_stack([rays[seen] * z[seen][:, None], z[seen]]))

    return decode


DEPTH = Sensor("depth images", (IMAGE, COMPRESSED), _find, _open)
