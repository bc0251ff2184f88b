"""What the command says about itself, and how it refuses wrong usage."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from gpgrad_core import __version__
from tests.end_to_end.process import ROOT, VERBS, environment, gpgrad, gpgrad_process


def test_version() -> None:
    finished = gpgrad("--version")
    assert (finished.code, finished.out, finished.err) == (0, f"{__version__}\n", "")


def test_the_verbs_are_listed() -> None:
    finished = gpgrad("--help")
    assert finished.code == 0
    for verb in VERBS:
        assert re.search(rf"\b{verb}\b", finished.out)


@pytest.mark.parametrize("verb", VERBS)
def test_every_flag_has_a_text_and_a_default(verb: str) -> None:
    finished = gpgrad(verb, "--help")
    assert finished.code == 0
    assert finished.err == ""
    text = " ".join(re.sub(r"[│╭╮╰╯─]", " ", finished.out).split())
    _, *flags = re.split(r" (?=--[a-z])(?!--[\w.-]+\])", text.split("-h, --help", 1)[1])
    named = [flag for flag in flags if not flag.startswith("--help")]
    assert named
    if verb == "detect":
        assert "Range: 0.01 to 100 m. (default: automatic)" in text
        assert "--closure.min-inliers" in text
    for flag in named:
        name = flag.split()[0].rstrip(",")
        following = flags[flags.index(flag) + 1] if flag != flags[-1] else ""
        paired = following.split(" ")[0].replace("no-", "") == name  # --open, --no-open
        if not paired:
            assert "(default:" in flag or "(required)" in flag, flag
            assert len(flag.split()) > 4, flag


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), f"Expected one of {{{', '.join(VERBS)}}}"),
        (("detekt", "x"), f"unknown verb 'detekt'; known: {', '.join(VERBS)}"),
        (("detect",), "--out"),
        (("detect", "x", "--out", "a.json", "--bogus", "3"), "--bogus"),
        (("detect", "x", "--out", "a.json", "--method", "magic"), "known: gradient"),
        (("detect", "x", "--out", "a.json", "--map.length-scale", "abc"), "--map.length-scale"),
        (
            ("detect", "x", "--out", "a.json", "--closure.min-inliers", "-1"),
            "--closure.min-inliers: the value must be from 0 to 1000, got -1",
        ),
        (("evaluate", "x", "--out", "r", "--method", "magic"), "unknown --method 'magic'"),
        (("reproduce", "--out", "r"), "DATASET"),
        (("reproduce", "x"), "--out"),
        (("reproduce", "x", "--out", "r", "--method", "magic"), "unknown --method 'magic'"),
        (("reproduce", "x", "--out", "r", "--figure", "7"), "--figure 7: there is no such figure"),
        (("reproduce", "x", "x", "--out", "r"), "x: is given twice; give it once"),
        (("reproduce", "x", "--out", "r", "--method", "chance"), "chance: has no gradient maps"),
        (("simulate", "x", "--num-submaps", "-3"), "--num-submaps: the value must be from"),
        (("view", "--port", "abc"), "--port: the value must be a whole number, got 'abc'"),
        (("evaluate", "x", "--out", "y", "--seed", "q"), "--seed: the value must be a whole"),
        (("map", "x", "--out", "y.npz", "--map.max-points", "3.5"), "a whole number, got '3.5'"),
    ],
)
def test_wrong_usage_is_one_line(arguments: tuple[str, ...], said: str) -> None:
    assert said in gpgrad(*arguments).refusal


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [("simulate", "--help"), ("--version",)])
def test_who_stops_reading_is_told_nothing(arguments: tuple[str, ...]) -> None:
    unread, output = os.pipe()
    os.close(unread)  # as `| head` does, once it has enough
    try:
        finished = subprocess.run(
            [sys.executable, "-m", "app", *arguments],
            stdout=output,
            stderr=subprocess.PIPE,
            cwd=ROOT,
            env=environment(),
            check=False,
        )
    finally:
        os.close(output)
    assert (finished.returncode, finished.stderr) == (141, b"")


@pytest.mark.slow
def test_wrong_usage_ends_the_process_with_2() -> None:
    assert "FOLDER" in gpgrad_process("simulate").refusal


def test_help_comes_without_the_libraries_that_take_long() -> None:
    code = (
        "import sys, app.cli\n"
        "heavy = {'numpy', 'scipy', 'cv2', 'viser', 'open3d', 'sklearn', 'matplotlib', 'gtsam'}\n"
        "heavy &= set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=environment(), cwd=ROOT)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verb", "heavy"),
    [
        ("map", {"viser", "open3d", "matplotlib", "gtsam", "scipy.optimize", "scipy.spatial"}),
        ("simulate", {"viser", "open3d", "matplotlib", "gtsam", "cv2"}),
        ("detect", {"viser", "open3d", "matplotlib", "gtsam"}),
        # Its first page is served before the rest is loaded.
        (
            "view",
            {"open3d", "matplotlib", "gtsam", "scipy", "tifffile", "app.viewer.features.session"},
        ),
    ],
)
def test_a_verb_loads_no_library_before_it_needs_it(verb: str, heavy: set[str]) -> None:
    code = (
        f"import sys, app.cli.{verb}\n"
        f"loaded = {heavy!r} & set(sys.modules)\n"
        "assert not loaded, loaded\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=environment(), cwd=ROOT)


@pytest.mark.slow
def test_the_core_loads_without_the_app(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom gpgrad_core import *\n"
        "strange = {'app', 'viser', 'tyro', 'tqdm', 'open3d', 'trimesh'} & set(sys.modules)\n"
        "assert not strange, strange\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=environment(), cwd=tmp_path)
