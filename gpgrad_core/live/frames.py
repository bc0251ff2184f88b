"""The messages between a robot and a viewer, and the frames in which they travel.

A frame is the length of its content, four bytes with the highest first, and the content: one
message in MessagePack, a map whose key ``type`` names the kind. Everything is bounded before it is
read.
"""

import struct
from collections.abc import Callable, Iterator
from typing import Annotated, Literal, TypeAlias, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec import Meta, Struct

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.ground import submap_of_cloud
from gpgrad_core.io.poses import make_pose
from gpgrad_core.reading.records import Finite
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Submap

VERSION = 1
LARGEST_FRAME = 64_000_000
"""Bytes; two and a half million points of 64 bits."""
MOST_POINTS = 2_500_000
LONGEST_ID = 100
LENGTH = struct.Struct(">I")
PIECE = 1 << 16
"""Bytes to read at once: memory grows as bytes come, not as a length announces them."""

Seven: TypeAlias = tuple[Finite, Finite, Finite, Finite, Finite, Finite, Finite]
"""A pose as in a TUM row: tx ty tz [m] qx qy qz qw."""
SubmapName: TypeAlias = Annotated[str, Meta(min_length=1, max_length=LONGEST_ID)]


class Hello(Struct, tag="hello", forbid_unknown_fields=True):
    """The robot's first message."""

    version: int = VERSION


class Submitted(Struct, tag="submap", forbid_unknown_fields=True):
    """A submap that the robot sends."""

    id: SubmapName
    points: bytes  # x, y and z [m] of each point in the submap's level frame, one after the other
    pose: Seven  # pose of that frame by odometry, ``T_world_submap``
    bits: Literal[32, 64] = 32  # of each number of the points, little-endian
    noise_std: bytes | None = None  # standard deviation of each height [m], of as many bits

    def submap(self) -> Submap:
        blank = not self.id.strip()
        if blank or not self.id.isprintable() or "/" in self.id or self.id.startswith("."):
            raise InputError(
                f"{self.id!a}: an id is printable and not blank, without slash or leading dot"
            )
        pose = make_pose(list(self.pose), f"submap {self.id}")
        points = self._numbers(self.points, 3).reshape(-1, 3)
        noise = None if self.noise_std is None else self._numbers(self.noise_std, 1)
        if noise is not None and len(noise) != len(points):
            raise InputError(
                f"{self.id}: has {len(points):,} points and {len(noise):,} standard deviations"
            )
        return submap_of_cloud(points, self.id, pose_odometry=pose, noise_std=noise)

    def _numbers(self, data: bytes, each: int) -> Float[NDArray[np.floating], "n"]:
        size = self.bits // 8
        count, rest = divmod(len(data), each * size)
        if rest:
            raise InputError(f"{self.id}: {len(data):,} bytes are no whole number of points")
        if count > MOST_POINTS:
            raise InputError(f"{self.id}: has {count:,} points; {MOST_POINTS:,} are the most")
        return np.frombuffer(data, f"<f{size}")


class Welcome(Struct, tag="welcome"):
    """The viewer's first message: which submaps it has on its disk already."""

    kept: list[str]
    version: int = VERSION


class Kept(Struct, tag="kept"):
    """The submap is on the viewer's disk."""

    id: str
    again: bool = False  # whether it was there before


class Refused(Struct, tag="refused"):
    """The submap cannot be used."""

    id: str
    reason: str


class Corrected(Struct, tag="corrected"):
    """What a submap has brought: to a robot, only poses that differ from its last ones."""

    id: str  # the newest submap
    poses: dict[str, Seven]
    closures: list[tuple[str, str]] = []  # those that it closes: query and database


Message = TypeVar("Message")
FromRobot: TypeAlias = Hello | Submitted
ToRobot: TypeAlias = Welcome | Kept | Refused | Corrected
_from_robot = msgspec.msgpack.Decoder(FromRobot)
_to_robot = msgspec.msgpack.Decoder(ToRobot)
Receive: TypeAlias = Callable[[int], bytes]
"""Gives at most so many bytes, and none at the end."""


def frame_of(message: FromRobot | ToRobot) -> bytes:
    """Write a message as a frame."""
    content = msgspec.msgpack.encode(message)
    if len(content) > LARGEST_FRAME:
        raise InputError(
            f"a message of {len(content):,} bytes is too large: {LARGEST_FRAME:,} are the most; "
            "thin the points"
        )
    return LENGTH.pack(len(content)) + content


def contents(receive: Receive, where: str) -> Iterator[bytes]:
    """Read frames, until their stream ends between two of them."""
    while head := _exactly(receive, LENGTH.size, where, may_end=True):
        (size,) = LENGTH.unpack(head)
        if size > LARGEST_FRAME:
            raise InputError(
                f"{where}: announces {size:,} bytes, and {LARGEST_FRAME:,} are the most; is it a "
                "stream of gpgrad's frames?"
            )
        yield _exactly(receive, size, where)


def _exactly(receive: Receive, size: int, where: str, *, may_end: bool = False) -> bytes:
    got = bytearray()
    while len(got) < size:
        piece = receive(min(PIECE, size - len(got)))
        if not piece:
            if may_end and not got:
                return b""
            raise InputError(f"{where}: ended within a message")
        got += piece
    return bytes(got)


def from_robot(content: bytes, where: str) -> FromRobot:
    """Read a robot's message."""
    message = _decoded(_from_robot, content, f"{where}: not a message of a robot")
    if isinstance(message, Hello) and message.version != VERSION:
        raise InputError(
            f"{where}: speaks version {message.version} of the messages, and this is version "
            f"{VERSION}; update gpgrad there or here"
        )
    return message


def to_robot(content: bytes, where: str) -> ToRobot:
    """Read a viewer's message."""
    return _decoded(_to_robot, content, f"{where}: not a message of a viewer")


def _decoded(decoder: msgspec.msgpack.Decoder[Message], content: bytes, wrong: str) -> Message:
    try:
        return decoder.decode(content)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise InputError(f"{wrong}: {error}") from None


def submitted(
    points: Float[NDArray[np.floating], "n 3"],
    pose: Pose,
    name: str,
    noise_std: Float[NDArray[np.floating], "n"] | None = None,
) -> Submitted:
    """Write a submap as a message: points of 32 bits in 32 bits, all others in 64."""
    rows = np.asarray(points)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"{name}: points must be an (n, 3) array, got shape {rows.shape}")
    bits: Literal[32, 64] = 32 if rows.dtype == np.float32 else 64
    kind = f"<f{bits // 8}"
    noise = None if noise_std is None else np.asarray(noise_std, kind).tobytes()
    return Submitted(name, rows.astype(kind).tobytes(), pose.row, bits, noise)
