"""Pairs of images with their calibration -> scans in the frame of the left camera."""

from collections.abc import Iterator, Sequence

from gpgrad_core.errors import InputError
from gpgrad_core.recordings.recording import Scan
from gpgrad_core.recordings.sensors.images import (
    COMPRESSED,
    IMAGE,
    cameras_of,
    is_depth,
    is_rectified,
    pairwise,
)
from gpgrad_core.recordings.sensors.sensor import Bag, Decode, Message, Sensor
from gpgrad_core.recordings.stereo import NO_MATCH, make_rig

NAMES = (
    ("left", "right"),
    ("infra1", "infra2"),
    ("cam0", "cam1"),
    ("camera0", "camera1"),
    ("image_0", "image_1"),
)
"""How the left and the right one of two topics are called."""


def _find(bag: Bag) -> list[tuple[str, ...]]:
    images = bag.of_type((IMAGE, COMPRESSED))
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
        for one, other in NAMES
        if one in topic and topic.replace(one, other) in images
    )
    return [
        pair
        for pair in dict.fromkeys(pairs)
        if all((m := bag.peek(topic)) is not None and not is_depth(m) for topic in pair)
    ]


def _open(bag: Bag, topics: tuple[str, ...]) -> Decode:
    bag.sources.refuse("image pairs have x, y and z only", "keep")
    left, right = cameras_of(bag, topics)
    first = [bag.peek(topic) for topic in topics]
    frames = [str(message.header.frame_id) for message in first if message is not None]
    between = None if frames[0] == frames[1] else bag.between(*frames)
    rig = make_rig(left, right, between, rectified=is_rectified(topics[0]))

    def decode(messages: Sequence[tuple[Message, ...]], where: Sequence[str]) -> Iterator[Scan]:
        for pair, place in zip(pairwise(messages, where), where, strict=True):
            yield rig.scan(*pair, place, bag.params.min_range)

    return decode


STEREO_PAIR = Sensor("image pairs", (IMAGE, COMPRESSED), _find, _open, batch=8, advice=NO_MATCH)
