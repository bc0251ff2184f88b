"""Bags that lack an index or metadata are read; metadata that take for ever are refused."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpgrad_core.recordings import bag_reader
from gpgrad_core.recordings.bag_reader import DEEPEST_YAML, is_bag, is_split_bag
from gpgrad_core.recordings.build import open_recording
from tests.core.recordings.test_bag import assert_holds
from tests.support.bags import write_bag
from tests.support.drive import Drive, make_drive
from tests.support.recordings import refused

pytest.importorskip("rosbags", reason="the extra 'ros' is not installed")
mcap_reader = pytest.importorskip("mcap.reader", reason="mcap is not installed")
mcap_writer = pytest.importorskip("mcap.writer", reason="mcap is not installed")
FEW = make_drive(num_scans=6, points_a_scan=50)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of ROS 2 with one MCAP file."""
    path = tmp_path_factory.mktemp("bags") / "whole"
    return write_bag(path, FEW, ros1=False, poses="odometry", storage="mcap")


def messages(path: Path) -> Iterator[tuple[Any, Any, Any]]:
    with path.open("rb") as stream:
        yield from mcap_reader.NonSeekingReader(stream).iter_messages()


def rewrite(source: Path, target: Path, *, shuffled: bool = False, **options: Any) -> None:
    """Write an MCAP file again, with other parts of an index."""
    found = list(messages(source))
    if shuffled:  # chunks begin later than those after them end
        found = found[len(found) // 2 :] + found[: len(found) // 2]
    with target.open("wb") as stream:
        out = mcap_writer.Writer(
            stream, compression=mcap_writer.CompressionType.ZSTD, chunk_size=2000, **options
        )
        out.start("ros2")
        channels: dict[int, int] = {}
        for schema, channel, message in found:
            if channel.id not in channels:
                kind = out.register_schema(schema.name, schema.encoding, schema.data)
                coding = channel.message_encoding
                made = out.register_channel(channel.topic, coding, kind, channel.metadata)
                channels[channel.id] = made
            times = message.log_time, message.data, message.publish_time
            out.add_message(channels[channel.id], *times)
        out.finish()


INDEX = mcap_writer.IndexType
PARTS: list[dict[str, Any]] = [
    {"index_types": INDEX.CHUNK},  # chunks, but not what is in them
    {"index_types": INDEX.CHUNK, "use_statistics": False},
    {"index_types": INDEX.NONE},
    {"index_types": INDEX.MESSAGE},
    {"repeat_channels": False},
    {"repeat_schemas": False},
    {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False},
    {"use_chunking": False, "repeat_channels": False, "use_statistics": False},
]


@pytest.mark.parametrize("options", PARTS, ids=str)
def test_an_mcap_that_lacks_parts_of_its_index(
    options: dict[str, Any], whole: Path, tmp_path: Path
) -> None:
    (source,) = whole.glob("*.mcap")
    path = tmp_path / "run.mcap"
    has_chunks = "NONE" not in str(options) and "MESSAGE" not in str(options)
    for shuffled in (False, True)[: 1 + (options.get("use_chunking", True) and has_chunks)]:
        rewrite(source, path, shuffled=shuffled, **options)
        assert len(list(messages(path))) == 2 * len(FEW.stamps) + 1
        recording = open_recording(path)
        assert_holds(recording, FEW)
        (third,) = (scan.points for scan in recording.read(2, 3))
        np.testing.assert_allclose(third, FEW.scans[2], atol=1e-5)
    path.write_bytes(path.read_bytes()[:-200])
    refused(path, str(path), "is not a complete bag")


@pytest.mark.parametrize(("ros1", "ending"), [(True, ".bag"), (False, ".mcap"), (False, ".db3")])
def test_files_of_a_split_bag_without_metadata(ros1: bool, ending: str, tmp_path: Path) -> None:
    parts = tmp_path / "run"
    parts.mkdir()
    storage = "mcap" if ending == ".mcap" else "sqlite3"
    for number in range(3):
        rows = slice(2 * number, 2 * number + 2)
        part = Drive(FEW.stamps[rows], FEW.body[rows], FEW.scans[rows])
        name = f"part{number}{ending * ros1}"
        written = write_bag(tmp_path / name, part, ros1=ros1, poses="odometry", storage=storage)
        (file,) = [written] if ros1 else written.glob(f"*{ending}")
        file.rename(parts / f"run_{number + 8}{ending}")  # 9 comes before 10
    assert_holds(open_recording(parts), FEW)
    (parts / "old.db3" if ending != ".db3" else parts / ".x.db3").write_bytes(b"")
    named = any("old.db3: not read" in note for note in open_recording(parts).notes)
    assert named == (ending != ".db3")
    (parts / "poses.npy").write_bytes(b"")
    assert is_bag(parts) == ros1
    assert not is_split_bag(parts)  # a folder of clouds


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_metadata_that_do_not_name_the_storage(storage: str, tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", FEW, ros1=False, poses="odometry", storage=storage)
    text = (path / "metadata.yaml").read_text()
    for name in ("''", "null"):
        changed = text.replace(f"storage_identifier: {storage}", f"storage_identifier: {name}")
        assert changed != text
        (path / "metadata.yaml").write_text(changed)
        assert_holds(open_recording(path), FEW)


def merges(levels: int) -> str:
    lines = ["a0: &a0 {k: 1}"]
    lines += [f"a{n}: &a{n} {{<<: [*a{n - 1}, *a{n - 1}], k{n}: 1}}" for n in range(1, levels)]
    return "\n".join(lines)


def aliases(levels: int) -> str:
    lines = ["a0: &a0 [1, 2]"]
    return "\n".join([*lines, *(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, levels))])


FEW_EVENTS = 1_000
"""The true limit takes seconds to reach."""
HOSTILE = {
    "merge keys": (merges(25), "it repeats the list or map"),
    "aliases": (aliases(40), "it repeats the list or map"),
    "a list": (f"a: [{'1,' * (FEW_EVENTS + 10)}]", f"more than {FEW_EVENTS:,} values"),
    "depth": ("a: " + "[" * 900 + "]" * 900, f"more than {DEEPEST_YAML} lists"),
    "blocks": ("- " * 900 + "1", f"more than {DEEPEST_YAML} lists"),
    "itself": ("a: &a [*a]", "it repeats the list or map"),
    "lines": ("\n" * (FEW_EVENTS + 10) + "a: 1", "values or lines"),
    "a long line": (f"a: '{'x' * bag_reader.LONGEST_LINE}'", "a line of more than"),
    "size": ("#" * 4_000_001, "is larger than"),
}
UNPARSED = ("a list", "lines", "a long line")
"""A parser needs seconds for them, in which nobody could cancel."""


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_metadata_are_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bag_reader, "MOST_EVENTS", FEW_EVENTS)
    if name in UNPARSED:
        monkeypatch.setattr("ruamel.yaml.YAML.parse", lambda *_: pytest.fail("it was parsed"))
    text, reason = HOSTILE[name]
    path = tmp_path / "bag"
    path.mkdir()
    (path / "metadata.yaml").write_text(text)
    refused(path, "metadata.yaml", reason)


def test_long_metadata_harmless_aliases_and_any_profile(whole: Path, tmp_path: Path) -> None:
    """A bag that was indexed anew has no profiles of its topics; hostile ones are not parsed."""
    path = tmp_path / "bag"
    path.mkdir()
    for file in whole.glob("*.mcap"):
        (path / file.name).write_bytes(file.read_bytes())
    text = (whole / "metadata.yaml").read_text()
    profiles = (r"- history: 3\n  depth: 0\n", "", merges(25).replace("\n", "\\n"))
    texts = [text.replace("profiles: []", f'profiles: "{profile}"') for profile in profiles]
    described = "".join(
        f"  - path: run_{n}.mcap\n    message_count: &c{n} 5\n"
        f"    duration: {{nanoseconds: *c{n}}}\n"
        for n in range(400)
    )
    texts.append(text.replace("  files:\n", f"  files:\n{described}"))
    for changed in texts:
        assert changed != text
        (path / "metadata.yaml").write_text(changed)
        assert_holds(open_recording(path), FEW)
