import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from app.viewer.features.data.unpacking import MOST_FILES, check_cloud, unpack
from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.run import Cancelled

MOST = 100_000


def packed(files: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content, compression)
    return buffer.getvalue()


def array() -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, np.zeros((4, 3)))
    return buffer.getvalue()


def refused(content: bytes, folder: Path) -> str:
    with pytest.raises(InputError) as error:
        unpack("mine.zip", content, folder / "new", MOST)
    assert list(folder.iterdir()) == []  # nothing is left, here or above
    message = str(error.value)
    assert message.startswith("mine.zip: ")
    assert "\n" not in message
    return message


def test_a_dataset_is_found_however_deep_it_was_packed(tmp_path: Path) -> None:
    files = {
        "home/etna/submaps/000.npy": array(),
        "home/etna/poses_gt.txt": b"0 0 0 0 0 0 0 1\n",
        "home/etna/submaps/run.sh": b"rm",
        "__MACOSX/home/._000.npy": b"",
        "home/etna/.DS_Store": b"",
    }
    seen: list[float] = []
    folder, notes = unpack("mine.zip", packed(files), tmp_path / "new", MOST, seen.append)
    assert folder == tmp_path / "new" / "home" / "etna"
    assert sorted(p.name for p in folder.rglob("*") if p.is_file()) == ["000.npy", "poses_gt.txt"]
    assert notes == ("mine.zip: 1 file was left out: not part of a dataset",)
    assert seen[-1] == 1.0
    bare, notes = unpack("b.zip", packed({"submaps/000.npy": array()}), tmp_path / "b", MOST)
    assert (bare, notes) == (tmp_path / "b", ())


@pytest.mark.parametrize(
    "name", ["../evil.ply", "/etc/evil.ply", "a/../../evil.ply", "..\\evil.ply", "C:evil.ply"]
)
def test_nothing_is_written_outside(tmp_path: Path, name: str) -> None:
    assert "outside" in refused(packed({"000.npy": array(), name: b"x"}), tmp_path)
    assert not (tmp_path.parent / "evil.ply").exists()


def test_links_are_refused(tmp_path: Path) -> None:
    link = zipfile.ZipInfo("000.ply")
    link.create_system, link.external_attr = 3, 0o120777 << 16
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(link, "/etc/passwd")
    assert "is a link" in refused(buffer.getvalue(), tmp_path)


def test_bombs_are_refused_before_they_go_off(tmp_path: Path) -> None:
    assert "would unpack to" in refused(packed({"000.xyz": bytes(MOST + 1)}), tmp_path)
    many = packed({f"{number}.xyz": b"" for number in range(MOST_FILES + 1)})
    assert "5,001 files" in refused(many, tmp_path)
    inner = packed({"points.npy": bytes(2 * MOST)})
    assert "000.npz would unpack to" in refused(packed({"000.npz": inner}), tmp_path)


def test_a_lie_about_the_size_is_no_way_round(tmp_path: Path) -> None:
    content = bytearray(packed({"000.xyz": bytes(3 * MOST)}))
    true, told = (3 * MOST).to_bytes(4, "little"), (10).to_bytes(4, "little")
    assert bytes(content).count(true) == 2  # in the file's own header and in the directory
    lying = bytes(content).replace(true, told)
    assert "not a complete zip archive" in refused(lying, tmp_path)


def test_what_is_no_archive_of_clouds_is_refused(tmp_path: Path) -> None:
    assert "not a complete zip" in refused(b"ply\nformat", tmp_path)
    whole = packed({"000.npy": array() * 50}, zipfile.ZIP_STORED)
    assert "not a complete zip" in refused(whole[: len(whole) // 2], tmp_path)
    broken = whole.replace(array()[:20], bytes(20), 1)
    assert "not a complete zip" in refused(broken, tmp_path)
    assert "holds no clouds" in refused(packed({"readme.md": b"hello"}), tmp_path)
    encrypted = bytearray(packed({"000.npy": array()}))
    start = encrypted.index(b"PK\x01\x02")
    encrypted[start + 8] |= 1
    assert "encrypted" in refused(bytes(encrypted), tmp_path)


def test_unpacking_can_be_cancelled(tmp_path: Path) -> None:
    def cancel(fraction: float) -> None:
        del fraction
        raise Cancelled

    with pytest.raises(Cancelled):
        unpack("mine.zip", packed({"000.npy": array()}), tmp_path / "new", MOST, cancel)
    assert list(tmp_path.iterdir()) == []


def test_a_single_cloud_is_checked(tmp_path: Path) -> None:
    (tmp_path / "000.exe").write_bytes(b"")
    with pytest.raises(InputError, match="neither a zipped dataset"):
        check_cloud(tmp_path / "000.exe", MOST)
    (tmp_path / "000.npz").write_bytes(packed({"points.npy": bytes(2 * MOST)}))
    with pytest.raises(InputError, match="would unpack"):
        check_cloud(tmp_path / "000.npz", MOST)
    (tmp_path / "001.npz").write_bytes(b"no")
    with pytest.raises(InputError, match="not a complete NPZ"):
        check_cloud(tmp_path / "001.npz", MOST)
    check_cloud(tmp_path / "002.npy", MOST)


def test_names_that_no_file_can_have_are_refused(tmp_path: Path) -> None:
    names = {
        "a" * 300 + ".npy": "longer than 200 bytes",
        "a/" * 2000 + "0.npy": "2,001 folders deep",
        "a\nb.npy": "control character",
        "\x1b[31m.npy": "control character",
    }
    for name, rule in names.items():
        assert rule in refused(packed({"000.npy": array(), name: array()}), tmp_path)


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("000.npy", array())
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("000.npy", array())
    assert "two files '000.npy'" in refused(buffer.getvalue(), tmp_path)


def test_a_compressed_cloud_that_grows_is_refused_within_and_alone(tmp_path: Path) -> None:
    """A short header promises many points; what a file may unpack to is counted before."""
    header = (
        b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 100000\nHEIGHT 1\n"
        b"POINTS 100000\nDATA binary_compressed\n"
    )
    assert "000.pcd would unpack to 1 MB" in refused(packed({"000.pcd": header}), tmp_path)
    (tmp_path / "000.pcd").write_bytes(header)
    with pytest.raises(InputError, match="would unpack to 1 MB"):
        check_cloud(tmp_path / "000.pcd", MOST)


def test_python_objects_in_arrays_are_never_loaded(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return open, (str(tmp_path / "sprung"), "w")

    for name, save in {"000.npy": np.save, "000.npz": np.savez}.items():
        buffer = io.BytesIO()
        save(buffer, np.array([Trap()], dtype=object))
        folder, _ = unpack("mine.zip", packed({name: buffer.getvalue()}), tmp_path / name, MOST)
        with pytest.raises(InputError, match="Python objects are never loaded"):
            load_dataset(folder)
    assert not (tmp_path / "sprung").exists()


def as_page_packs(files: list[tuple[str, bytes]]) -> bytes:
    head = json.dumps([(name, len(content)) for name, content in files])
    return b"\n".join([head.encode(), b"".join(content for _, content in files)])


def test_a_folder_that_a_page_has_packed_is_taken_apart(tmp_path: Path) -> None:
    files = [("etna/submaps/000.npy", array()), ("etna/film.mp4", b""), ("etna/name.txt", b"Etna")]
    folder, notes = unpack("etna.folder", as_page_packs(files), tmp_path / "new", MOST)
    assert folder == tmp_path / "new" / "etna"
    assert (folder / "name.txt").read_bytes() == b"Etna"
    assert (folder / "submaps" / "000.npy").read_bytes() == array()
    assert notes == ("etna: 1 file was left out: not part of a dataset",)


@pytest.mark.parametrize(
    ("content", "rule"),
    [
        (as_page_packs([("a.npy", array())])[:-1], "did not arrive as it was packed"),
        (b'[["a.npy", -1]]\n', "did not arrive as it was packed"),
        (b'[["a.npy", 1e9]]\n', "did not arrive as it was packed"),
        (b"\xff\n", "did not arrive as it was packed"),
        (b"", "did not arrive as it was packed"),
        (as_page_packs([("../a.npy", array())]), "outside of its folder"),
        (as_page_packs([("a.mp4", b"film")]), "holds no clouds"),
        (as_page_packs([("a.txt", b" " * (MOST + 1))]), "would unpack to"),
    ],
)
def test_a_packed_folder_that_is_none_is_refused(content: bytes, rule: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rule) as error:
        unpack("mine.folder", content, tmp_path / "new", MOST)
    assert str(error.value).startswith("mine: ")
    assert list(tmp_path.iterdir()) == []
