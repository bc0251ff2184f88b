#!/usr/bin/env python3
"""Builds the packages of a release, checks them, and installs the wheel in an empty environment.

    .ci/release.py                   build and check; leaves nothing
    .ci/release.py --tag v1.2.3      … for this tag, whose notes the changelog must have
    .ci/release.py --out DIR         … and keep the packages and the notes there

The wheel is made of the source package, as others will make it. It must hold the two packages and
the demo, and serve the demo's page where nothing but its own dependencies is installed. Exit code
1 if anything failed.
"""

import argparse
import re
import subprocess
import sys
import tempfile
import venv
import zipfile
from pathlib import Path

from versions import ROOT, fetch_page

TOOLS = ("build", "hatchling", "twine")
NEEDED = (
    *("app/viewer/viewer.py", "app/viewer/features/save/report.html", "gpgrad_core/py.typed"),
    *("gpgrad_core/simulation/demo/dataset.toml", "gpgrad_core/evaluation/templates/report.md"),
)
PARTS = {"app", "gpgrad_core"}


class ReleaseError(Exception):
    """What must be mended before a release."""


def read_version() -> str:
    """Read the version that the packages will have."""
    text = (ROOT / "gpgrad_core" / "__init__.py").read_text(encoding="utf-8")
    found = re.search(r'__version__ = "([^"]+)"', text)
    assert found is not None
    return found[1]


def notes_of(version: str) -> str:
    """Take the notes of a version out of the changelog.

    Raises:
        ReleaseError: If it has none.
    """
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = rf"^## \[?{re.escape(version)}\]?.*?$\n(.*?)(?=^## |\Z)"
    found = re.search(heading, text, re.MULTILINE | re.DOTALL)
    if found is None or not found[1].strip():
        raise ReleaseError(f"CHANGELOG.md: has no notes under '## {version}'")
    return found[1].strip() + "\n"


def make_environment(folder: Path, *packages: object) -> Path:
    """Make an environment that holds these packages only; gives the folder of its programs.

    It is used once, so that only what is imported is compiled, and without a pip of its own.
    """
    venv.create(folder)
    pip = (sys.executable, "-m", "pip", "--python", folder / "bin" / "python")
    run(*pip, "install", "-q", "--no-compile", *packages)
    return folder / "bin"


def run(*command: object) -> str:
    """Run a command; gives what it printed.

    Raises:
        ReleaseError: If it fails; the message has the end of its output.
    """
    words = [str(part) for part in command]
    finished = subprocess.run(
        words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    if finished.returncode:
        tail = "\n".join(finished.stdout.strip().splitlines()[-25:])
        raise ReleaseError(f"{' '.join(words)}\n{tail}")
    return finished.stdout


def build(tools: Path, out: Path) -> Path:
    """Build the source package and, of that, the wheel; gives the wheel."""
    run(tools / "python", "-m", "build", "--no-isolation", "--outdir", out, ROOT)
    run(tools / "python", "-m", "twine", "check", "--strict", *sorted(out.iterdir()))
    (wheel,) = out.glob("*.whl")
    return wheel


def check_contents(wheel: Path) -> None:
    """Check that a wheel has what it needs, and nothing that is not part of the program.

    Raises:
        ReleaseError: If not.
    """
    names = zipfile.ZipFile(wheel).namelist()
    missing = [name for name in NEEDED if name not in names]
    strange = {name.split("/")[0] for name in names} - PARTS
    strange = {name for name in strange if not name.endswith(".dist-info")}
    if missing or strange:
        raise ReleaseError(
            f"{wheel.name}: lacks {missing or 'nothing'}, has {strange or 'no'} extra"
        )


def try_wheel(wheel: Path, folder: Path, version: str) -> str:
    """Install a wheel in an empty environment, and run what the README runs first.

    Raises:
        ReleaseError: If it does not install, or does not start.
    """
    programs = make_environment(folder / "fresh", wheel)
    said = run(programs / "gpgrad", "--version").strip()
    if version not in said:
        raise ReleaseError(f"gpgrad --version says {said!r}, not {version}")
    try:
        return fetch_page(programs / "gpgrad", folder)
    except RuntimeError as error:
        raise ReleaseError(f"gpgrad view does not start:\n{error}") from error


def main() -> int:
    """Build and check."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tag", help="such as v1.2.3; must be that of the version")
    parser.add_argument("--out", type=Path, help="keeps the packages, and the notes as notes.md")
    asked = parser.parse_args()
    version = read_version()
    try:
        with tempfile.TemporaryDirectory(prefix="gpgrad-release-") as name:
            folder = Path(name)
            if asked.tag is not None:
                if asked.tag != f"v{version}":
                    raise ReleaseError(f"the tag is {asked.tag}, but the version {version}")
                notes = notes_of(version)
            else:
                notes = ""
            out = asked.out or folder / "dist"
            out.mkdir(parents=True, exist_ok=True)
            if any(out.iterdir()):
                raise ReleaseError(f"{out}: is not empty")
            wheel = build(make_environment(folder / "tools", *TOOLS), out)
            check_contents(wheel)
            print(f"{wheel.name}: {try_wheel(wheel, folder, version)}")
            if notes and asked.out is not None:
                (out / "notes.md").write_text(notes, encoding="utf-8")
    except ReleaseError as error:
        print(f"FAILED: {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
