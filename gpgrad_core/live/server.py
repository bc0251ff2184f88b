"""Submaps from robots that connect: each gets an answer once its submap is stored, and poses."""

import contextlib
import math
import queue
import socket
import threading
import time
from collections.abc import Iterator

from gpgrad_core.errors import InputError
from gpgrad_core.live import frames
from gpgrad_core.live.source import Arrival, News, Source, Trouble

MOST_ROBOTS = 4
"""Connections at a time; each may hold a message in memory."""
LOOK_UP = 0.2
"""A reader that waits looks up so often whether it is still wanted [s]."""
SLOWEST = 10.0
"""Time [s] within which a robot must read its messages, and say hello; else it is disconnected."""
SILENT = 60.0
"""A robot that has said nothing for so long [s] makes room for another; it connects again."""
KEEPALIVE = {"TCP_KEEPIDLE": 30, "TCP_KEEPINTVL": 10, "TCP_KEEPCNT": 3}
"""When the system asks whether a silent robot is still there, where it can be told so [s]."""


class Server(Source):
    """Listens at a `port`, on this machine alone unless another host is named."""

    def __init__(self, host: str = "127.0.0.1", port: int = 8090) -> None:
        """Listen; port 0 takes any that is free."""
        self._news: queue.Queue[News] = queue.Queue(maxsize=MOST_ROBOTS)
        self._robots: set[_Robot] = set()
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._latest: frames.Corrected | None = None
        try:
            self._socket = socket.create_server((host, port))
        except OSError as error:
            reason = error.strerror or error
            raise InputError(f"tcp://{host}:{port}: cannot listen there: {reason}") from None
        self._socket.settimeout(LOOK_UP)
        self.port = int(self._socket.getsockname()[1])
        super().__init__(f"tcp://{host}:{self.port}")
        self._threads: list[threading.Thread] = []

    def news(self, stopped: threading.Event) -> Iterator[News]:
        accepting = threading.Thread(target=self._accept, name="live-accept", daemon=True)
        accepting.start()
        self._threads.append(accepting)
        while not stopped.is_set():
            with contextlib.suppress(queue.Empty):
                yield self._news.get(timeout=LOOK_UP)

    def tell(self, corrected: frames.Corrected) -> None:
        with self._lock:
            self._latest = corrected
            for robot in self._robots:
                robot.tell(corrected)

    def close(self) -> None:
        self._closed.set()
        self._socket.close()
        with self._lock:
            robots = tuple(self._robots)
        for robot in robots:
            robot.close()
        for thread in self._threads:
            thread.join(SLOWEST)

    def _accept(self) -> None:
        while not self._closed.is_set():
            try:
                connection, address = self._socket.accept()
            except TimeoutError:
                continue
            except OSError:  # closed; or the robot was gone again, or too many files are open
                self._closed.wait(LOOK_UP)
                continue
            where = f"robot at {address[0]}:{address[1]}"
            robot = _Robot(connection, where)
            silent: _Robot | None = None
            with self._lock:
                if full := len(self._robots) >= MOST_ROBOTS:
                    # One that never greeted, or else the one that is silent for longest.
                    silent = min(self._robots, key=lambda one: (one.greeted, one.heard))
                    full = silent.greeted and time.monotonic() - silent.heard < SILENT
                    self._robots -= set() if full else {silent}
                if not full:
                    self._robots.add(robot)
            if full:
                robot.refuse(f"it is full: {MOST_ROBOTS} robots are connected, which is the most")
                self._put(Trouble(f"{where}: refused, for {MOST_ROBOTS} are connected already"))
                continue
            if silent is not None:
                silent.refuse("it is full: you were silent, and make room for another robot")
                self._put(Trouble(f"{silent.where}: was silent, and makes room for another"))
            thread = threading.Thread(
                target=self._serve, args=(robot,), name="live-robot", daemon=True
            )
            self._threads = [t for t in self._threads if t.is_alive()]
            self._threads.append(thread)
            thread.start()

    def _serve(self, robot: "_Robot") -> None:
        try:
            self._listen_to(robot)
        except InputError as error:
            self._put(Trouble(str(error)))
            robot.refuse(str(error))
        except OSError:
            pass  # it is gone, and comes again if it wants
        finally:
            with self._lock:
                self._robots.discard(robot)
            robot.close()

    def _listen_to(self, robot: "_Robot") -> None:
        for content in frames.contents(robot.receive, robot.where):
            message = frames.from_robot(content, robot.where)
            if isinstance(message, frames.Hello):
                welcome = frames.Welcome(list(self._stored_ids()))
                # At once, so that a robot that was welcomed is not taken for one that never said
                # hello, and nothing older is told after something newer.
                with self._lock:
                    robot.send(welcome)
                    robot.greeted = True
                    if self._latest is not None:
                        robot.tell(self._latest)
                continue
            if not robot.greeted:
                raise InputError(f"{robot.where}: sends before it has said hello")
            self._take(message, robot)

    def _take(self, message: frames.Submitted, robot: "_Robot") -> None:
        answered = threading.Event()

        def answer(reply: frames.Kept | frames.Refused) -> None:
            robot.send(reply)
            answered.set()

        try:
            arrival = Arrival(message.submap(), answer)
        except InputError as error:
            robot.send(frames.Refused(message.id, str(error)))
            self._put(Trouble(str(error)))
            return
        robot.heard = math.inf  # it is not silent, it waits
        self._put(arrival)
        while not answered.wait(LOOK_UP) and not self._closed.is_set():
            pass  # the next submap of this robot waits: so no more than one is in memory
        robot.heard = time.monotonic()

    def _put(self, news: News) -> None:
        while not self._closed.is_set():
            with contextlib.suppress(queue.Full):
                self._news.put(news, timeout=LOOK_UP)
                return


class _Robot:
    def __init__(self, connection: socket.socket, where: str) -> None:
        self.where = where
        self._connection = connection
        connection.settimeout(SLOWEST)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in KEEPALIVE.items():
            if hasattr(socket, name):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        self.greeted = False
        self.since = self.heard = time.monotonic()  # when it connected, and was heard last
        self._lock = threading.Lock()
        self._known: dict[str, frames.Seven] = {}

    def receive(self, size: int) -> bytes:
        while self.greeted or time.monotonic() - self.since < SLOWEST:
            with contextlib.suppress(TimeoutError):  # a robot may be silent for hours
                data = self._connection.recv(size)
                self.heard = time.monotonic()
                return data
        raise InputError(f"{self.where}: has not said hello within {SLOWEST:g} s")

    def refuse(self, reason: str) -> None:
        with contextlib.suppress(OSError):
            self._connection.settimeout(LOOK_UP)  # one that does not read keeps nobody waiting
        self.send(frames.Refused("", reason))
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_WR)
            self._connection.recv(frames.PIECE)  # its hello, or else the system drops the reason
        self.close()

    def send(self, message: frames.ToRobot) -> None:
        try:
            with self._lock:
                self._connection.sendall(frames.frame_of(message))
        except OSError:  # it is gone, or does not read
            self.close()

    def tell(self, corrected: frames.Corrected) -> None:
        """Send the poses that it does not know yet; the server's lock is held."""
        if not self.greeted:
            return
        poses = {k: p for k, p in corrected.poses.items() if self._known.get(k) != p}
        self._known.update(poses)
        self.send(frames.Corrected(corrected.id, poses, corrected.closures))

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)
        self._connection.close()
