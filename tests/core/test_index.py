"""The index is what the contract with users promises; a library that is missing is named."""

import inspect
import sys
from pathlib import Path

import pytest

import gpgrad_core as gg
from gpgrad_core.errors import InputError
from gpgrad_core.libraries import DEBIAN_PACKAGES, load_library

TYPES = {
    *("SE2", "Submap", "Grid", "GradientMap", "Features", "Matches", "Registration"),
    *("LoopClosure", "LoopDetector", "Dataset", "PipelineParams", "MapParams"),
}
VERBS = {
    "load_dataset": ["path"],
    "infer_gradient_map": ["submap", "params"],
    "extract_features": ["gradient_map", "params"],
    "match_features": ["query", "database", "params"],
    "register": ["query", "database", "matches", "params"],
    "classify": ["registration", "params"],
    "detect_loop_closures": ["dataset", "params"],
    "build_pose_graph": ["dataset", "closures", "params"],
    "optimise_pose_graph": ["graph", "params"],
}


def test_every_name_of_the_index_is_there() -> None:
    assert all(hasattr(gg, name) for name in gg.__all__)
    assert TYPES | set(VERBS) <= set(gg.__all__)


def test_verbs_take_what_is_promised_in_its_order() -> None:
    for name, promised in VERBS.items():
        taken = list(inspect.signature(getattr(gg, name)).parameters)
        assert taken[: len(promised)] == promised


def test_params_have_the_promised_names_and_defaults() -> None:
    params = gg.MapParams(length_scale=0.3, noise_std=0.02, resolution=0.03)
    assert params.signal_std is None
    assert params.max_points is None


ROOT = Path(__file__).resolve().parents[2]


def test_one_that_is_not_installed_is_named_with_what_to_install() -> None:
    assert load_library("json").loads("[1]") == [1]
    with pytest.raises(InputError) as refusal:
        load_library("no_such_package.part", "gpgrad[extra]")
    assert str(refusal.value) == "no_such_package is not installed: pip install 'gpgrad[extra]'"


GONE = "cannot open shared object file: No such file or directory"


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (
            f'raise ImportError("libusb-1.0.so.0: {GONE}")',
            "the system library libusb-1.0.so.0 is missing; on Debian: apt-get install "
            "libusb-1.0-0",
        ),
        (
            f'raise ImportError("libother.so.3: {GONE}")',
            "the system library libother.so.3 is missing; install the package that holds it",
        ),
        ('raise ImportError("built for another\\nNumPy")', "built for another NumPy"),
        ("import no_such_package", "No module named 'no_such_package'"),
    ],
)
def test_one_that_fails_to_load_says_why_in_one_line(
    code: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "fragile.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "fragile", raising=False)
    with pytest.raises(InputError) as refusal:
        load_library("fragile")
    assert str(refusal.value) == f"fragile cannot be loaded: {said}"


def test_the_readme_asks_for_the_packages_that_open3d_needs() -> None:
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    line = next(line for line in lines if "apt-get install" in line)
    needed = ("libusb-1.0-0", "libegl1", "libgl1")
    assert {"python3-venv", *needed} <= set(line.split())
    assert set(needed) <= set(DEBIAN_PACKAGES.values())
