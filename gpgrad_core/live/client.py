"""The robot's side: a dozen lines send submaps to a viewer, and get the corrected track back."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.poses import pose_row
from gpgrad_core.live import frames
from gpgrad_core.se2 import Pose

PORT = 8090
AGAIN = 0.2
"""Time between two attempts to connect [s]."""
Track = Mapping[str, Pose]
"""``T_world_submap`` of each submap so far, by its id."""


class Live:
    """Sends submaps to ``gpgrad view --follow PORT``, and takes the corrected track.

        with gg.Live("localhost:8090") as live:
            for name, points, pose in robot:
                if name not in live.kept:
                    corrected = live.add(points, pose, id=name)

    A submap is on the viewer's disk when `add` returns. If the connection breaks before that, it
    connects again and sends it again, for as long as its patience lasts.

    Attributes:
        kept: The ids of all submaps on the viewer's disk, also those of an earlier connection.
    """

    def __init__(
        self,
        address: str = "localhost:8090",
        *,
        patience: float = 30.0,
        on_corrected: Callable[[Track], None] | None = None,
    ) -> None:
        """Connect.

        Args:
            address: Host and port of the viewer.
            patience: How long to try to connect, and to wait for an answer [s].
            on_corrected: Called with the whole track when a part of it has changed, in a thread of
                its own.

        Raises:
            InputError: If the address is none, or nobody answers there in time.
        """
        self._address = _parsed(address)
        self._where, self._patience, self._on_corrected = address, patience, on_corrected
        self._changed = threading.Condition()
        self._stored: set[str] = set()
        self._refused: dict[str, str] = {}
        self._poses: dict[str, Pose] = {}
        self._closures: set[tuple[str, str]] = set()
        self._connection: socket.socket | None = None
        self._reader: threading.Thread | None = None
        self._connect(time.monotonic() + patience)

    def __enter__(self) -> "Live":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def kept(self) -> frozenset[str]:
        """The ids of all submaps that are on the viewer's disk."""
        with self._changed:
            return frozenset(self._stored)

    @property
    def track(self) -> Track:
        """The corrected poses that came so far, by id."""
        with self._changed:
            return MappingProxyType(dict(self._poses))

    @property
    def closures(self) -> frozenset[tuple[str, str]]:
        """The loop closures that came so far, as query and database."""
        with self._changed:
            return frozenset(self._closures)

    def tum_lines(self) -> tuple[str, ...]:
        """Write the corrected track as TUM rows, ``id tx ty tz qx qy qz qw``."""
        return tuple(pose_row(name, pose) for name, pose in self.track.items())

    def add(
        self,
        points: Float[NDArray[np.floating], "n 3"],
        pose: Pose,
        *,
        id: str,
        noise_std: Float[NDArray[np.floating], "n"] | None = None,
        wait: bool = True,
    ) -> Track:
        """Send a submap; it is on the viewer's disk when this returns.

        Args:
            points: Positions (n, 3) in the submap's level frame [m]; those of 32 bits are sent so.
            pose: Pose of that frame by odometry, ``T_world_submap``; z points up.
            id: Its name. The last number in it says which place it has in the traverse.
            noise_std: Standard deviation of each point's height (n,) [m], if it is known.
            wait: Whether to wait until the viewer has compared it too, so that the track has it.

        Returns:
            The corrected poses so far; without waiting, those that have come already.

        Raises:
            InputError: If the viewer refuses the submap, or does not answer in time.
        """
        message = frames.submitted(points, pose, id, noise_std)
        frame = frames.frame_of(message)
        deadline = time.monotonic() + self._patience
        with self._changed:
            self._refused.pop(id, None)
        while not self._send(message, frame, deadline):
            if time.monotonic() > deadline:
                raise InputError(f"{self._where}: the connection breaks with submap {id}")
            self._connect(deadline)
        if wait:
            with self._changed:
                if not self._changed.wait_for(lambda: id in self._poses, self._patience):
                    raise InputError(
                        f"{self._where}: submap {id} is kept, but was not compared within "
                        f"{self._patience:g} s; the viewer is slower than the robot"
                    )
        return self.track

    def close(self) -> None:
        self._disconnect()

    def _send(self, message: frames.Submitted, frame: bytes, deadline: float) -> bool:
        """Send a submap, and wait until it is on the disk; False if the connection broke."""
        connection = self._connection
        if connection is None:
            return False
        with self._changed:
            self._stored.discard(message.id)  # whether it is the same is for the viewer to say
        try:
            connection.sendall(frame)
        except OSError:
            return False

        def is_answered() -> bool:
            answered = message.id in self._stored or message.id in self._refused
            return answered or self._connection is not connection

        with self._changed:
            left = max(0.0, deadline - time.monotonic())
            if not self._changed.wait_for(is_answered, left):
                raise InputError(
                    f"{self._where}: submap {message.id} was not kept within {self._patience:g} s"
                )
            if message.id in self._refused:
                raise InputError(self._refused[message.id])
            return message.id in self._stored

    def _connect(self, deadline: float) -> None:
        """Connect, and receive the ids of the submaps on the viewer's disk."""
        self._disconnect()
        while True:
            try:
                connection, kept = self._handshake(max(AGAIN, deadline - time.monotonic()))
                break
            except (OSError, InputError) as error:
                if time.monotonic() + AGAIN <= deadline:
                    time.sleep(AGAIN)
                    continue
                if isinstance(error, InputError):
                    raise
                raise InputError(
                    f"{self._where}: nobody answers: {error.strerror or error}; start gpgrad "
                    f"view --follow {self._address[1]} there"
                ) from None
        connection.settimeout(None)
        with self._changed:
            self._stored = set(kept)
            self._connection = connection
        self._reader = threading.Thread(
            target=self._listen, args=(connection,), name="live-client", daemon=True
        )
        self._reader.start()

    def _handshake(self, seconds: float) -> tuple[socket.socket, list[str]]:
        """Connect once, within some seconds; also gives the ids on the viewer's disk."""
        with contextlib.ExitStack() as closing:
            connection = closing.enter_context(socket.create_connection(self._address, seconds))
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.sendall(frames.frame_of(frames.Hello()))
            content = next(frames.contents(connection.recv, self._where), None)
            if content is None:
                raise InputError(f"{self._where}: has hung up without an answer; try it again")
            welcome = frames.to_robot(content, self._where)
            if isinstance(welcome, frames.Refused):
                raise InputError(f"{self._where}: {welcome.reason}")
            if not isinstance(welcome, frames.Welcome) or welcome.version != frames.VERSION:
                raise InputError(f"{self._where}: is no viewer of this version of gpgrad")
            closing.pop_all()  # it stays open
            return connection, welcome.kept

    def _disconnect(self) -> None:
        with self._changed:
            connection, self._connection = self._connection, None
        if connection is not None:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()
        if self._reader is not None and self._reader is not threading.current_thread():
            self._reader.join()

    def _listen(self, connection: socket.socket) -> None:
        try:
            for content in frames.contents(connection.recv, self._where):
                self._on_message(frames.to_robot(content, self._where))
        except (OSError, InputError):
            pass  # `add` connects again
        connection.close()
        with self._changed:
            if self._connection is connection:
                self._connection = None
            self._changed.notify_all()

    def _on_message(self, message: object) -> None:
        with self._changed:
            if isinstance(message, frames.Kept):
                self._stored.add(message.id)
            elif isinstance(message, frames.Refused):
                self._refused[message.id] = message.reason
            elif isinstance(message, frames.Corrected):
                self._poses |= {name: Pose.of_row(pose) for name, pose in message.poses.items()}
                self._closures.update(message.closures)
            self._changed.notify_all()
        if (
            isinstance(message, frames.Corrected)
            and message.poses
            and self._on_corrected is not None
        ):
            self._on_corrected(self.track)


def _parsed(address: str) -> tuple[str, int]:
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise InputError(f"{address}: an address is HOST:PORT, such as localhost:{PORT}")
    return host.strip("[]") or "localhost", int(port)
