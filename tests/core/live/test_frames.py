"""Messages are bounded before they are read, and hold what was written into them."""

import contextlib
import io
import threading
import tracemalloc

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.errors import InputError
from gpgrad_core.live.frames import (
    LARGEST_FRAME,
    LENGTH,
    Hello,
    Submitted,
    contents,
    frame_of,
    from_robot,
    submitted,
    to_robot,
)
from gpgrad_core.live.source import Arrival, Stream, Trouble
from gpgrad_core.se2 import Pose
from tests.core.live.submaps import row
from tests.support.refusal import assert_refused

POSE = Pose(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 0.6, 0.8]))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_submap_is_what_was_sent(kind: type) -> None:
    points = row(1)[0].points.astype(kind)
    noise = np.full(len(points), 0.02, kind)
    frame = frame_of(submitted(points, POSE, "a_7", noise))
    (content,) = contents(io.BytesIO(frame).read, "a pipe")
    message = from_robot(content, "a pipe")
    assert isinstance(message, Submitted)
    made = message.submap()
    np.testing.assert_array_equal(made.points, points.astype(np.float64))
    np.testing.assert_array_equal(made.noise_std, noise.astype(np.float64))
    np.testing.assert_allclose(made.pose_odometry.quaternion, POSE.quaternion)
    assert made.id == "a_7"


def test_a_huge_promise_takes_no_memory() -> None:
    announced = LENGTH.pack(LARGEST_FRAME) + b"few bytes"
    tracemalloc.start()
    assert_refused(lambda: list(contents(io.BytesIO(announced).read, "here")), "here", "ended")
    too_large = LENGTH.pack(LARGEST_FRAME + 1)
    assert_refused(lambda: list(contents(io.BytesIO(too_large).read, "here")), "64,000,000")
    # An array of 4 billion elements, and strings and maps that are promised but not there.
    for promise in (b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff"):
        head = msgspec.msgpack.encode({"type": "submap", "id": "1"})
        content = bytes([head[0] + 1]) + head[1:] + b"\xa6points" + promise
        assert_refused(lambda content=content: from_robot(content, "here"), "here")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2_000_000


def test_deep_and_odd_messages_are_refused() -> None:
    deep = b"\x91" * 100_000 + b"\xc0"
    for content in (deep, b"", b"\xc0", msgspec.msgpack.encode({"type": "shell"}), b"\x80"):
        assert_refused(lambda content=content: from_robot(content, "here"), "here")
        with pytest.raises(InputError):
            to_robot(content, "here")
    extra = msgspec.msgpack.encode({"type": "hello", "more": b"\x91" * 1000})
    assert_refused(lambda: from_robot(extra, "here"), "more")


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"points": b"123"}, "whole number of points"),
        ({"pose": (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0)}, "length 1"),
        ({"noise_std": bytes(8)}, "standard deviations"),
        ({"id": "../a"}, "slash"),
        ({"id": "\x1b[2J"}, r"\x1b"),  # the terminal must not obey it
        ({"points": bytes(24)}, "3 or more"),
    ],
)
def test_what_is_no_submap_is_refused(changed: dict[str, object], words: str) -> None:
    good = submitted(row(1)[0].points, POSE, "7")
    broken = msgspec.structs.replace(good, **changed)
    assert_refused(broken.submap, words)


@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    with contextlib.suppress(InputError):  # and no other error
        for content in contents(io.BytesIO(data).read, "here"):
            from_robot(content, "here")


def test_a_pipe_is_read_as_it_comes() -> None:
    sent = row(3)
    frames = [frame_of(Hello()), *(frame_of(submitted(s.points, POSE, s.id)) for s in sent)]
    flat = submitted(np.zeros((9, 3)), POSE, "flat")
    stream = Stream(io.BytesIO(b"".join([*frames, frame_of(flat)])).read, "a pipe")
    *arrivals, trouble = stream.news(threading.Event())
    assert [a.submap.id for a in arrivals if isinstance(a, Arrival)] == [s.id for s in sent]
    assert isinstance(trouble, Trouble)
    assert "flat" in trouble.text
