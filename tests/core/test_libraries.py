"""What is said where a library is missing, or misses a library of the system."""

import sys
from pathlib import Path

import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.libraries import DEBIAN_PACKAGES, load_library

ROOT = Path(__file__).resolve().parents[2]


def test_a_library_that_is_there_is_loaded() -> None:
    assert load_library("json").loads("[1]") == [1]


def test_one_that_is_not_installed_is_named_with_what_to_install() -> None:
    with pytest.raises(InputError) as refusal:
        load_library("no_such_package.part", "gpgrad[extra]")
    assert str(refusal.value) == "no_such_package is not installed: pip install 'gpgrad[extra]'"


@pytest.mark.parametrize(
    ("cause", "said"),
    [
        (
            "libusb-1.0.so.0: cannot open shared object file: No such file or directory",
            "fragile cannot be loaded: the system library libusb-1.0.so.0 is missing; on Debian: "
            "apt-get install libusb-1.0-0",
        ),
        (
            "libother.so.3: cannot open shared object file: No such file or directory",
            "fragile cannot be loaded: the system library libother.so.3 is missing; install the "
            "package that holds it",
        ),
        ("built for another\\nNumPy", "fragile cannot be loaded: built for another NumPy"),
    ],
)
def test_one_that_fails_to_load_says_why_in_one_line(
    cause: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "fragile.py").write_text(f'raise ImportError("{cause}")\n')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "fragile", raising=False)
    with pytest.raises(InputError) as refusal:
        load_library("fragile")
    assert str(refusal.value) == said


def test_one_that_misses_another_package_says_which(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "needy.py").write_text("import no_such_package\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match="needy cannot be loaded: No module named 'no_such"):
        load_library("needy")


def test_the_readme_asks_for_the_packages_that_open3d_needs() -> None:
    line = next(
        line
        for line in (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
        if "apt-get install" in line
    )
    for package in ("python3-venv", "libusb-1.0-0", "libegl1", "libgl1"):
        assert package in line.split()
        assert package == "python3-venv" or package in DEBIAN_PACKAGES.values()
