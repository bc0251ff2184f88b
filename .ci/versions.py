#!/usr/bin/env python3
"""Installs gpgrad with other Pythons and other releases of its libraries, and tries it.

    .ci/versions.py                     newest and lowest releases, on every Python that is found
    .ci/versions.py --python 3.13       on this one only
    .ci/versions.py --newer --start     the newest Python found, newest releases, no tests
    .ci/versions.py --system PATH …     the system's own Python, newest releases, these tests

For each it makes an environment, starts the viewer, detects the loop closures of a small simulated
dataset and runs the tests; then it prints one line. The lowest releases are those that a resolver
finds when it takes the lowest of every direct dependency that has a wheel. It needs `uv`, which the
extra `dev` brings. Exit code 1 if anything failed.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
OLDEST = (3, 11)
SYSTEM = Path("/usr/bin/python3")
"""A distribution keeps its Python's patch release for years."""
SHOWN = ("numpy", "scipy", "opencv-contrib-python-headless", "open3d", "open3d-cpu", "viser")
START_SECONDS = 120


@dataclass(frozen=True)
class Python:
    """An interpreter of this machine, and its version with the patch release."""

    version: tuple[int, int, int]
    path: Path


def find_pythons() -> list[Python]:
    """Find one interpreter of each version that gpgrad supports, the oldest first."""
    names = [f"python3.{minor}" for minor in range(OLDEST[1], OLDEST[1] + 10)]
    candidates = [Path(found) for name in names if (found := shutil.which(name))]
    candidates += sorted(Path.home().glob(".pyenv/versions/*/bin/python"))
    candidates += sorted(Path.home().glob(".local/share/uv/python/*/bin/python"))
    candidates.append(Path(sys.executable))
    pythons = [python for path in candidates if (python := ask_version(path))]
    found = {python.version[:2]: python for python in reversed(pythons)}
    return [found[version] for version in sorted(found)]


def ask_version(path: Path) -> Python | None:
    """Ask an interpreter for its version; None if gpgrad cannot be installed with it."""
    try:
        said = subprocess.run(
            [path, "-c", "import sys, venv; print(*sys.version_info[:3])"],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
    except (OSError, subprocess.CalledProcessError):
        return None
    major, minor, patch = map(int, said.split())
    return Python((major, minor, patch), path) if (major, minor) >= OLDEST else None


def fetch_page(gpgrad: Path, folder: Path) -> str:
    """Start the viewer on the demo, and fetch its page.

    Args:
        gpgrad: The installed command.
        folder: Where it is started.

    Raises:
        RuntimeError: If it does not start; the message is what it said.
    """
    with subprocess.Popen(
        [gpgrad, "view", "--no-open", "--port", "0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=folder,
    ) as viewer:
        try:
            assert viewer.stdout is not None
            begun = time.monotonic()
            said = ""  # what was fitted comes before the address
            address = None
            while address is None and (line := viewer.stdout.readline()):
                said += line
                address = re.search(r"http://\S+", line)
            if address is None:
                raise RuntimeError(said)
            with urllib.request.urlopen(address[0], timeout=START_SECONDS) as page:
                page.read()
            return f"page served after {time.monotonic() - begun:.0f} s"
        finally:
            viewer.kill()


@dataclass(frozen=True)
class Trial:
    """One Python with one choice of releases.

    Attributes:
        python: The interpreter.
        resolution: The newest or the lowest releases, in the words of `uv`.
        folder: Where the environment is made.
        tests: Those to run; empty for all of the default ones, None for none.
    """

    python: Python
    resolution: str
    folder: Path
    tests: tuple[str, ...] | None

    def run(self, *command: object, **options: object) -> subprocess.CompletedProcess[str]:
        """Run a command in the folder; its output is kept."""
        environment = {
            key: value
            for key, value in os.environ.items()
            if key not in ("PYTHONPATH", "VIRTUAL_ENV")
        }
        return subprocess.run(
            [str(part) for part in command],
            capture_output=True,
            text=True,
            check=True,
            env=environment | {"UV_LINK_MODE": "hardlink"},
            **options,  # type: ignore[call-overload]
        )

    @property
    def bin(self) -> Path:
        """Folder of the environment's programs."""
        return self.folder / "venv" / "bin"

    def install(self) -> None:
        """Install gpgrad and what its tests need."""
        uv = shutil.which("uv") or str(Path(sys.executable).with_name("uv"))
        pins = self.folder / "pins.txt"
        self.run(uv, "venv", "-q", "--seed", "--python", self.python.path, self.folder / "venv")
        python = self.bin / "python"
        resolve = ["--resolution", self.resolution, "--only-binary", ":all:"]
        extras = [] if self.tests is None else ["--extra", "dev"]
        self.run(
            *(uv, "pip", "compile", "-q", ROOT / "pyproject.toml", *extras, *resolve),
            *("--python", python, "-o", pins),
        )
        # Compiled here: later, old packages would warn while they are, and warnings are errors.
        into = ["pip", "install", "-q", "--python", python, "--compile-bytecode"]
        self.run(uv, *into, "-r", pins)
        self.run(uv, *into, "--no-deps", "-e", ROOT)

    def versions(self) -> str:
        """Name the releases that matter most."""
        listed = json.loads(self.run(self.bin / "pip", "list", "--format", "json").stdout)
        installed = {entry["name"].lower(): entry["version"] for entry in listed}
        return ", ".join(
            f"{name.split('-')[0]} {installed[name]}" for name in SHOWN if name in installed
        )

    def start(self) -> str:
        """Start the viewer on the demo, and fetch its page."""
        return fetch_page(self.bin / "gpgrad", self.folder)

    def detect(self) -> str:
        """Detect the loop closures of a small simulated dataset with several methods."""
        gpgrad, data = self.bin / "gpgrad", self.folder / "data"
        self.run(gpgrad, "simulate", data, "--num-submaps", 6, cwd=self.folder)
        outputs = {name: self.folder / f"{name}.json" for name in ("gradient", "fpfh", "shot")}
        for method, out in outputs.items():
            self.run(gpgrad, "detect", data, "--method", method, "--out", out, cwd=self.folder)
        pairs = json.loads(outputs["gradient"].read_text())["pairs"]
        return f"{sum(pair['accepted'] for pair in pairs)} of {len(pairs)} pairs accepted"

    def test(self) -> str:
        """Run the tests; their last line."""
        finished = self.run(
            self.bin / "python", "-m", "pytest", "-q", *(self.tests or ()), cwd=ROOT
        )
        return finished.stdout.strip().splitlines()[-1]

    def report(self) -> bool:
        """Do all of it and print the line; whether all went well."""
        name = f"Python {'.'.join(map(str, self.python.version))}, {self.resolution}"
        said: list[str] = []
        steps = [self.install, self.versions, self.start, self.detect]
        for step in steps if self.tests is None else [*steps, self.test]:
            try:
                said += [line for line in [step()] if line]
            except subprocess.CalledProcessError as error:
                tail = "\n".join((error.stdout + error.stderr).strip().splitlines()[-25:])
                print(f"{name}: {'; '.join(said)}; {step.__name__} FAILED:\n{tail}", flush=True)
                return False
            except RuntimeError as error:
                print(f"{name}: {'; '.join(said)}; {step.__name__} FAILED:\n{error}", flush=True)
                return False
        print(f"{name}: {'; '.join(said)}", flush=True)
        return True


def main() -> int:
    """Try what was asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--newer", action="store_true", help="only the newest Python found")
    parser.add_argument("--python", action="append", help="only this version, such as 3.13")
    parser.add_argument(
        "--system", nargs="+", metavar="PATH", help=f"only {SYSTEM}, and of the tests only these"
    )
    parser.add_argument("--start", action="store_true", help="install, start, detect; no tests")
    parser.add_argument(
        "--resolution",
        choices=["highest", "lowest-direct"],
        action="append",
        help="which releases of the libraries; both by default",
    )
    asked = parser.parse_args()
    pythons = find_pythons()
    if asked.newer:
        pythons = [python for python in pythons[-1:] if python.version[:2] > sys.version_info[:2]]
        if not pythons:
            here = ".".join(map(str, sys.version_info[:2]))
            print(f"no Python newer than {here} was found: nothing newer was tried")
            return 0
    if asked.system:
        own = ask_version(SYSTEM)
        pythons = [own] if own and own.version < sys.version_info[:3] else []
        if not pythons:
            print(f"{SYSTEM} is no older than this Python: nothing older was tried")
            return 0
    if asked.python:
        wanted = {tuple(map(int, version.split("."))) for version in asked.python}
        pythons = [python for python in pythons if python.version[:2] in wanted]
        if len(pythons) < len(wanted):
            print(f"not all found: {', '.join(asked.python)}")
            return 1
    resolutions = asked.resolution or (
        ["highest"] if asked.newer or asked.system else ["highest", "lowest-direct"]
    )
    tests = None if asked.start else tuple(asked.system or ())
    well = True
    for python in pythons:
        for resolution in resolutions:
            with tempfile.TemporaryDirectory(prefix="gpgrad-versions-") as folder:
                trial = Trial(python, resolution, Path(folder), tests)
                well = trial.report() and well
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
