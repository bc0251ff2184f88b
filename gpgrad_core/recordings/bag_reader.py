"""The files of a ROS 1 or ROS 2 bag, and the reader of its messages.

The reader is that of rosbags, but for three things. Metadata whose YAML would take for ever are
refused before they are parsed. They need not name the storage, nor agree with it on the quality of
service. And an MCAP file may lack any part of its index.
"""

import contextlib
import importlib.util
from collections.abc import Callable, Generator
from functools import lru_cache
from pathlib import Path
from struct import Struct
from typing import Any, TypeAlias

from gpgrad_core.errors import InputError, said
from gpgrad_core.io.clouds import is_cloud
from gpgrad_core.libraries import load_library
from gpgrad_core.recordings.sensors import SENSORS
from gpgrad_core.run.progress import Cancelled

BagReader: TypeAlias = Any
"""Of rosbags, which makes its types while it runs."""
ENDINGS = (".bag", ".mcap", ".db3")
LARGEST_YAML = 4_000_000
"""Most bytes of a bag's metadata; those of 10,000 files take half."""
MOST_VALUES = 150_000
"""Most values in a text of YAML, repeated ones counted each time; 10,000 files take 150,000."""
DEEPEST_YAML = 32
"""Most lists and maps within one another; in a bag's metadata there are seven."""
RECORD, CHUNK = Struct("<BQ"), Struct("<QQQI")
"""What a record of an MCAP file begins with, and then that of a chunk (mcap.dev/spec)."""
MESSAGE_CODE, CHUNK_CODE = 0x05, 0x06


def bag_files(path: Path) -> list[Path]:
    """List the files of a bag, or its folder if that has ROS 2's metadata; none if it is no bag.

    Files in a folder without metadata are one bag, in the order of their numbers; of several kinds,
    the first of `ENDINGS` counts.
    """
    if path.is_file():
        return [path] if path.suffix.lower() in ENDINGS else []
    if (path / "metadata.yaml").exists():
        return [path]
    parts = (
        [f for f in path.glob(f"*{ending}") if f.is_file() and not f.name.startswith(".")]
        for ending in ENDINGS
    )
    return sorted(next(filter(None, parts), []), key=lambda file: (len(file.name), file.name))


def is_bag(path: Path) -> bool:
    """Tell whether a path is a bag: a file, a folder of ROS 2, or a folder of ``.bag`` files."""
    return bool(files := bag_files(path)) and (files[0] == path or files[0].suffix == ".bag")


def is_split_bag(path: Path) -> bool:
    """Tell whether a folder has files of a bag, ROS 2's metadata or not, and no clouds."""
    return bool(bag_files(path)) and not any(map(is_cloud, path.iterdir()))


@contextlib.contextmanager
def read_bag(path: Path) -> Generator[BagReader]:
    """Open a bag's reader; every error of the bag becomes an InputError of one line."""
    try:
        highlevel = load_library("rosbags.highlevel", "gpgrad[ros]")
        typesys = load_library("rosbags.typesys", "gpgrad[ros]")
    except InputError as error:
        raise InputError(f"{path}: to read bags, {error}") from None
    # Bags of early ROS 2 releases do not define their message types.
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for sensor in SENSORS:
        for name, text in sensor.definitions.items():
            store.register(typesys.get_types_from_msg(text, name))
    try:
        metadata = path / "metadata.yaml"
        if metadata.is_file() and metadata.stat().st_size > LARGEST_YAML:
            raise InputError(f"{metadata}: is larger than {LARGEST_YAML:,} bytes")
        whole = highlevel.AnyReader(bag_files(path), default_typestore=store)
        for part in whole.readers if whole.is2 else ():
            part.storage = _storage()(part.path)
        with whole as reader:
            yield reader
    except (InputError, Cancelled):
        raise
    except Exception as error:  # rosbags, sqlite, lz4 and zstd each raise their own
        raise InputError(f"{path}: is not a complete bag: {said(error)}") from None


@lru_cache
def _storage() -> Callable[[Path], Any]:
    """Make the function that gives the reader of ROS 2's storage, a folder or a file."""
    mcap, sqlite, reader = map(_own_module, ("storage_mcap", "storage_sqlite3", "reader"))
    reader.YAML = _bounded_yaml()
    for module in (mcap, sqlite, reader):
        # Else the quality of service, YAML again, must be the same in metadata and file.
        module.parse_qos = _no_profiles

    class McapReader(mcap.McapReader):
        """Reads files that lack a part of their index, or all of it."""

        def read_index(self) -> None:
            super().read_index()
            counted = self.statistics or all(c.message_index_offsets for c in self.chunks)
            if not (self.schemas and self.channels and counted):
                # As if there were no index: the data are looked through.
                for kept in (self.schemas, self.channels, self.chunks, self.connections):
                    kept.clear()
                self.statistics = None

        def open(self) -> None:
            super().open()
            self.chunks[:] = self.chunks or self._find_chunks()
            for chunk in self.chunks:
                if not chunk.message_index_offsets:  # any channel may be in it
                    chunk.channel_count.update(dict.fromkeys(self.channels, 1))

        def _find_chunks(self) -> list[Any]:
            """Find the chunks of a file that does not list them; none if messages lie outside."""
            chunks: list[Any] = []
            start = self.data_start
            while start + RECORD.size < self.data_end:
                self.bio.seek(start)
                code, size = RECORD.unpack(mcap.read_exact(self.bio, RECORD.size))
                if code == MESSAGE_CODE:
                    return []
                if code == CHUNK_CODE:
                    since, until, unpacked, _ = CHUNK.unpack(mcap.read_exact(self.bio, CHUNK.size))
                    compression = mcap.read_string(self.bio)
                    (packed,) = mcap.deserialize_uint64(mcap.read_exact(self.bio, 8))
                    place = since, until, start, RECORD.size + size, {}, 0
                    chunks.append(mcap.ChunkInfo(*place, compression, packed, unpacked, {}))
                start += RECORD.size + size
            return chunks

    def file(path: Path) -> Any:
        return (McapReader if path.suffix == ".mcap" else sqlite.Sqlite3Reader)(path)

    def folder(path: Path) -> Any:
        storage = reader.DirectoryReader(path)
        # Bags that ROS 2 has indexed anew may not name their storage.
        names = ("mcap", McapReader), ("sqlite3", sqlite.Sqlite3Reader), ("", file), (None, file)
        storage.STORAGE_PLUGINS = dict(names)
        return storage

    return lambda path: folder(path) if path.is_dir() else file(path)


def _own_module(part: str) -> Any:
    """Load a module of rosbags once more, so that others who use rosbags see no change in it."""
    name = f"rosbags.rosbag2.{part}"
    load_library(name)
    spec = importlib.util.find_spec(name)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _no_profiles(_text: object) -> list[object]:
    return []


def _bounded_yaml() -> type[Any]:
    """Make rosbags' parser of YAML, for texts that it can parse in bounded time and memory."""
    yaml = load_library("ruamel.yaml")

    class BoundedYaml(yaml.YAML):
        def load(self, stream: str) -> Any:
            return parse(stream)

    @lru_cache(maxsize=2)  # a bag's metadata are asked for again for each submap
    def parse(text: str) -> Any:
        reason = _reason_against(yaml, text)
        if reason:
            raise yaml.YAMLError(reason)
        return yaml.YAML(typ="safe").load(text)

    return BoundedYaml


def _reason_against(yaml: Any, text: str) -> str:
    """Say why a text of YAML cannot be parsed in bounded time; empty if it can."""
    count, sizes = 0, dict[str, int]()
    above: list[tuple[str | None, int]] = []  # the anchors of lists and maps around, and the count
    for event in yaml.YAML(typ="safe").parse(text):
        begins = isinstance(event, yaml.CollectionStartEvent)
        anchor = event.anchor if isinstance(event, yaml.NodeEvent) else None
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in sizes:
                return f"it repeats {event.anchor!r} within itself"
            count += sizes[event.anchor]
        elif begins:
            above.append((anchor, count))
            count += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, since = above.pop()
            sizes |= {anchor: count - since} if anchor else {}
        elif isinstance(event, yaml.ScalarEvent):
            count += 1
            sizes |= {anchor: 1} if anchor else {}
        if count > MOST_VALUES:
            return f"it has more than {MOST_VALUES:,} values, with those that are repeated"
        if len(above) > DEEPEST_YAML:
            return f"it is more than {DEEPEST_YAML} lists and maps deep"
    return ""
