"""The files of a ROS 1 or ROS 2 bag, and the reader of its messages.

The reader is that of rosbags, but for three things. Metadata whose YAML would take for ever are
refused before they are parsed. They need not name the storage, nor agree with it on the quality of
service. And an MCAP file may lack any part of its index.
"""

import contextlib
import importlib.util
from collections.abc import Callable, Generator
from functools import lru_cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeAlias

from gpgrad_core.errors import InputError, message_of
from gpgrad_core.io.clouds import is_cloud
from gpgrad_core.libraries import load_library
from gpgrad_core.reading.files import check_regular
from gpgrad_core.recordings.sensors import DEFINITIONS
from gpgrad_core.run import Cancelled

BagReader: TypeAlias = Any
"""Of rosbags, which makes its types while it runs."""
ENDINGS = (".bag", ".mcap", ".db3")
LARGEST_YAML, LONGEST_LINE, MOST_EVENTS, DEEPEST_YAML = 4_000_000, 200_000, 150_000, 32
"""Most bytes of a bag's metadata, characters of a line, values with ends of lists and maps, and
their depth; 8,000 files take half of the bytes and all of the values, seven deep."""


def bag_files(path: Path) -> list[Path]:
    """List the files of a bag, or its folder if that has ROS 2's metadata; none if it is no bag."""
    if path.is_file():
        return [path] if path.suffix.lower() in ENDINGS else []
    if (path / "metadata.yaml").exists():
        return [path]
    parts = (
        [f for f in path.glob(f"*{ending}") if f.is_file() and not f.name.startswith(".")]
        for ending in ENDINGS
    )
    return sorted(next(filter(None, parts), []), key=lambda file: (len(file.name), file.name))


def inner_files(path: Path) -> list[Path]:
    """List the files of a bag, with those in its folder."""
    parts = ([*sorted(file.iterdir())] if file.is_dir() else [file] for file in bag_files(path))
    return [file for part in parts for file in part]


def other_files(path: Path) -> list[str]:
    """Name the files of other kinds of bags in a folder without metadata."""
    files = bag_files(path)
    beside = path.iterdir() if path.is_dir() and path not in files else ()
    return sorted(f.name for f in beside if f.suffix in ENDINGS and f not in files)


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file, a folder of ROS 2, or a folder of ``.bag`` files."""
    return bool(files := bag_files(path)) and (files[0] == path or files[0].suffix == ".bag")


def is_split_bag(path: Path) -> bool:
    """Whether a folder has files of a bag, ROS 2's metadata or not, and no clouds."""
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
    for name, text in DEFINITIONS.items():
        store.register(typesys.get_types_from_msg(text, name))
    try:
        metadata = path / "metadata.yaml"
        if metadata.is_file() and metadata.stat().st_size > LARGEST_YAML:
            raise InputError(f"{metadata}: is larger than {LARGEST_YAML:,} bytes")
        for file in inner_files(path):
            if not file.is_dir():
                check_regular(file)
        whole = highlevel.AnyReader(bag_files(path), default_typestore=store)
        for part in whole.readers if whole.is2 else ():
            part.storage = _storage()(part.path)
        with whole as reader:
            yield reader
    except (InputError, Cancelled):
        raise
    except Exception as error:  # rosbags, sqlite, lz4 and zstd each raise their own
        raise InputError(f"{path}: is not a complete bag: {message_of(error)}") from None


@lru_cache
def _storage() -> Callable[[Path], Any]:
    """Make the function that gives the reader of ROS 2's storage, a folder or a file."""
    mcap, sqlite, reader = map(_own_module, ("storage_mcap", "storage_sqlite3", "reader"))
    reader.YAML = partial(SimpleNamespace, load=_load_yaml)

    def no_profiles(_: object) -> tuple[()]:
        return ()

    for module in (mcap, sqlite, reader):
        # Else the quality of service, YAML again, must be the same in metadata and file.
        module.parse_qos = no_profiles

    class McapReader(mcap.McapReader):
        """Reads files that lack a part of their index, or all of it."""

        def read_index(self) -> None:
            super().read_index()
            counted = self.statistics or all(c.message_index_offsets for c in self.chunks)
            if not (self.schemas and self.channels and counted):
                self.connections.clear()
                self.meta_scan()
            for chunk in self.chunks:
                if not chunk.message_index_offsets:  # any channel may be in it
                    chunk.channel_count.update(dict.fromkeys(self.channels, 1))

    def storage(path: Path) -> Any:
        if not path.is_dir():
            return (McapReader if path.suffix == ".mcap" else sqlite.Sqlite3Reader)(path)
        # Bags that ROS 2 has indexed anew may not name their storage.
        named = {"mcap": McapReader, "sqlite3": sqlite.Sqlite3Reader, "": storage, None: storage}
        folder = reader.DirectoryReader(path)
        folder.STORAGE_PLUGINS = named
        return folder

    return storage


def _own_module(part: str) -> Any:
    """Load a module of rosbags once more, so that others who use rosbags see no change in it."""
    spec = load_library(f"rosbags.rosbag2.{part}").__spec__
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@lru_cache(maxsize=2)  # a bag's metadata are asked for again for each submap
def _load_yaml(text: str) -> Any:
    """Parse a bag's metadata, unless this could take for ever."""
    yaml: Any = load_library("ruamel.yaml")
    # A parser in Python needs seconds to find out what a look at the text tells at once.
    if sum(map(text.count, ",\n")) > MOST_EVENTS:
        raise yaml.YAMLError(f"it has more than {MOST_EVENTS:,} values or lines")
    if max(map(len, text.splitlines()), default=0) > LONGEST_LINE:
        raise yaml.YAMLError(f"it has a line of more than {LONGEST_LINE:,} characters")
    depth, repeatable = 0, set[str]()
    for count, event in enumerate(yaml.YAML(typ="safe").parse(text)):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            repeatable.add(event.anchor)
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.AliasEvent) and event.anchor in repeatable:
            raise yaml.YAMLError(f"it repeats the list or map {event.anchor!r}: write it out")
        if count > MOST_EVENTS:
            raise yaml.YAMLError(f"it has more than {MOST_EVENTS:,} values")
        if depth > DEEPEST_YAML:
            raise yaml.YAMLError(f"it is more than {DEEPEST_YAML} lists and maps deep")
    try:
        return yaml.YAML(typ="safe").load(text)
    except ValueError:  # whose words are for programmers
        raise yaml.YAMLError("it has a number of thousands of digits, or no date") from None
