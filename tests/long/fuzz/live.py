"""Records of drives, and frames of submaps as they come by standard input and over a socket."""

import contextlib
import io
import queue
import random
import socket
import tempfile
import threading
import zlib
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import msgspec
import numpy as np

from app.viewer.features.world.model import Past, marks_of
from gpgrad_core.detection.shortlist import Candidate
from gpgrad_core.errors import InputError
from gpgrad_core.live.frames import LENGTH, PIECE, Hello, Kept, frame_of, submitted
from gpgrad_core.live.server import Server
from gpgrad_core.live.source import Arrival, News, Stream, Trouble
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import Moment, RunWriter, read_run
from gpgrad_core.slam.run_file import HEAD, MAGIC
from gpgrad_core.types import Agreement, Context, LoopClosure, Registration, Submap
from tests.long.fuzz.mutation import Case, at_random, flipped

HERE = Pose(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 0.6, 0.8]))
ODD = (None, True, -1, 2**63, 1e308, float("nan"), float("inf"), "", "a\nb", "x" * 20_000, b"",
       bytes(7), [], [[]] * 50, {}, {"a": {}}, [0.0] * 7)  # fmt: skip
"""Stand in for a value of a message."""
LAST = "last"
"""Id of the submap by which it is known that all before it was heard."""


def _submap(number: int) -> Submap:
    points = np.random.default_rng(number).normal(size=(12, 3))
    return Submap.from_points(points, f"{number:03d}", pose_odometry=HERE)


@cache
def _record() -> bytes:
    """Write a drive of two submaps, which was settled."""
    registration = Registration(
        SE2(1.0, 2.0, 0.5),
        np.arange(9) < 5,
        dissimilarity=1.0,
        overlap_area=30.0,
        correlation=0.5,
        score=4.0,
        covariance=np.eye(3),
        scale=0.3,
        agreement=Agreement(0.1, 0.1, 1.0),
    )
    context = Context(4.0, 4.0, 1.0, 0.0, 1)
    closure = LoopClosure("001", "000", registration, True, "4 >= 3", context=context)
    alone = Moment(
        odometry=HERE,
        starts_traverse=False,
        closures=(),
        shortlist=None,
        flipped=(),
        rejected=(),
        ids=("000",),
        places=np.array([HERE.row]),
        covariances=np.eye(3)[None],
        moved=0.0,
    )
    both = replace(
        alone,
        closures=(closure,),
        shortlist=(Candidate("000", 3, 0.5),),
        rejected=(("001", "000"),),
        ids=("000", "001"),
        places=np.array([HERE.row] * 2),
        covariances=np.array([np.eye(3)] * 2),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "run.gpgrad")
        with RunWriter(path) as writer:
            for number, moment in enumerate((alone, both)):
                writer.keep(_submap(number))
                writer.add(moment)
            writer.settle(both)
        return path.read_bytes()


def record_of(contents: Iterable[bytes]) -> bytes:
    """Write a record of entries; its sums are right."""
    heads = (HEAD.pack(len(content), zlib.crc32(content)) + content for content in contents)
    return MAGIC + b"".join(heads)


def entries_of_record() -> list[dict[str, Any]]:
    content, entries = _record()[len(MAGIC) :], list[dict[str, Any]]()
    while content:
        end = HEAD.size + HEAD.unpack_from(content)[0]
        entries.append(msgspec.msgpack.decode(content[HEAD.size : end]))
        content = content[end:]
    return entries


def _places(value: object) -> list[tuple[Any, Any]]:
    """List where in a message a value may be replaced: the containers, each with a key."""
    keys = (
        value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    )
    return [place for key in keys for place in ((value, key), *_places(value[key]))]


def record(rng: random.Random) -> Case:
    """The record of a drive; its sums are right, so that what is odd within is read."""
    entries = entries_of_record()
    _, first, told, second, told_second, settled = entries
    what = rng.choice(
        ("value", "value", "value", "gone", "order", "rows", "pose", "name", "sum", "bytes",
         "random")
    )  # fmt: skip
    damaged = what not in ("value", "bytes")
    match what:
        case "value":
            container, key = rng.choice(_places(rng.choice(entries)))
            container[key] = rng.choice(ODD)
        case "gone":
            entry = rng.choice(entries)
            del entry[
                rng.choice([key for key in entry if key in ("type", "id", "submap", "params")])
            ]
        case "order":
            number = rng.randrange(4)
            if rng.random() < 0.5:
                del entries[number]
            else:
                entries.insert(rng.randrange(number, 5) + 1, entries[number])
        case "rows":
            entry = rng.choice((told, told_second, settled))
            key = rng.choice(("places", "covariances"))
            rest, nan = entry[key][:-8], np.float64("nan").tobytes()
            entry[key] = rng.choice((rest, rest[:-1], rest + nan, rest + bytes(16)))
        case "pose":
            rng.choice((first, second))["pose_odometry"][rng.choice((5, 6))] = rng.choice(
                (0.0, 9.0)
            )
        case "name":
            told_second["pairs"][0][rng.choice(("query", "database"))] = "00\n9"
        case "sum":
            content = bytearray(_record())
            content[len(MAGIC) + rng.randrange(HEAD.size)] ^= 1 << rng.randrange(8)
            return Case(bytes(content), what, damaged)
        case "bytes":
            packed = [msgspec.msgpack.encode(entry) for entry in entries]
            number = rng.randrange(len(packed))
            packed[number] = flipped(rng, packed[number])
            return Case(record_of(packed), what, damaged)
        case _:
            return at_random(rng, _record())
    return Case(record_of(map(msgspec.msgpack.encode, entries)), what, damaged)


def read_record(path: Path) -> object:
    """Read a record, and make what the time line shows of it."""
    run = read_run(path)
    assert all(path.name in note and "\n" not in note for note in run.notes)
    for number in range(len(run.moments)):
        past = Past(run.dataset, run.moments, number)
        assert past.words
        assert past.poses.keys() == past.odometry.keys()
        assert past.correction.loops is not None
    return marks_of(run.moments)


def frames(rng: random.Random) -> Case:
    """What a robot says: hello, and two submaps, of which the second has noise."""
    noise = np.full(12, 0.02)
    said = (
        Hello(),
        submitted(_submap(0).points, HERE, "000"),
        submitted(_submap(1).points, HERE, "001", noise),
    )
    messages: list[dict[str, Any]] = [
        msgspec.msgpack.decode(msgspec.msgpack.encode(message)) for message in said
    ]
    what = rng.choice(
        ("value", "value", "wrong", "wrong", "version", "gone", "more", "length", "cut", "deep",
         "bytes", "random")
    )  # fmt: skip
    damaged = what not in ("value", "bytes")
    last = messages[2]
    match what:
        case "value":
            container, key = rng.choice(_places(messages))
            container[key] = rng.choice(ODD)
        case "wrong":
            key, wrong = rng.choice((
                ("id", ("", "../a", ".a", "a\nb", "\x1b[2J", "x" * 101, 7, None)),
                ("points", (b"", bytes(288), bytes(289), "x" * 288, None, [0.0] * 36,
                            np.full(36, 1e30).tobytes(), np.full(36, np.nan).tobytes())),
                ("pose", ([], [0.0] * 7, [0.0] * 8, [1e300, 0, 0, 0, 0, 0, 2.0], "0000001", None)),
                ("bits", (16, 0, -32, "64", 64.0)),
                ("noise_std", (b"", bytes(96), bytes(95), np.full(12, -1.0).tobytes())),
                ("type", ("shell", "welcome", "", None, 3)),
            ))  # fmt: skip
            last[key] = rng.choice(wrong)
        case "version":
            messages[0]["version"] = rng.choice((2, -1, "1", None, 1.5))
        case "gone":
            del last[rng.choice(("id", "points", "pose", "type"))]
        case "more":
            rng.choice(messages)[rng.choice(("x", "Points", ""))] = rng.choice(ODD[:6])
        case _:
            pass
    packed = [msgspec.msgpack.encode(message) for message in messages]
    if what == "bytes":
        number = rng.randrange(3)
        packed[number] = flipped(rng, packed[number])
    if what == "deep":
        packed[2] = rng.choice((b"\x91" * 100_000, b"\x81\xa1a" * 50_000, b"\xdd\xff\xff\xff\xff"))
    whole = b"".join(LENGTH.pack(len(one)) + one for one in packed)
    if what == "random":
        return at_random(rng, whole)
    if what == "cut":
        whole = whole[: -rng.randrange(1, LENGTH.size + len(packed[2]))]
    if what == "length":
        size = rng.choice((0, 1, len(packed[0]) - 1, len(packed[0]) + 1, 64_000_001, 2**32 - 1))
        whole = LENGTH.pack(size) + whole[LENGTH.size :]
    return Case(whole, what, damaged)


def read_frames(path: Path) -> object:
    """Read frames as from standard input."""
    stream = Stream(io.BytesIO(path.read_bytes()).read, path.name)
    return _refused(path, list(stream.news(threading.Event())))


@cache
def _server() -> tuple[Server, "queue.SimpleQueue[News | threading.ExceptHookArgs]"]:
    server = Server(port=0)
    heard = queue.SimpleQueue[News | threading.ExceptHookArgs]()

    def listen() -> None:
        for news in server.news(threading.Event()):
            heard.put(news)
            if isinstance(news, Arrival):
                news.answer(Kept(news.submap.id))

    threading.Thread(target=listen, daemon=True).start()
    return server, heard


def read_socket(path: Path) -> object:
    """Send frames to a server, which goes on serving others."""
    server, heard = _server()
    last = frame_of(Hello()) + frame_of(submitted(_submap(0).points, HERE, LAST))
    with mock.patch.object(threading, "excepthook", heard.put):
        for content in (path.read_bytes(), last):
            with (
                socket.create_connection(("127.0.0.1", server.port), 10.0) as robot,
                contextlib.suppress(OSError),  # of what is refused, the rest is not read
            ):
                robot.sendall(content)
                robot.shutdown(socket.SHUT_WR)
                while robot.recv(PIECE):
                    pass
    said = list[News]()
    while True:
        news = heard.get(timeout=10.0)
        if isinstance(news, threading.ExceptHookArgs):
            raise RuntimeError(f"a thread of the server died of {news.exc_value!r}")
        if isinstance(news, Arrival) and news.submap.id == LAST:
            return _refused(path, said)
        said.append(news)


def _refused(path: Path, news: list[News]) -> list[News]:
    """Raise what was said of messages that are no submaps."""
    for one in news:
        if isinstance(one, Trouble):
            raise InputError(f"{path.name}: {one.text}")
    return news
