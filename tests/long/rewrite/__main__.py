"""Does a tree of the code write the same files as another one? Every verb, on real ground.

    python -m tests.long.rewrite --before /tmp/before --now . --data DIR

`--before` and `--now` are checkouts, `--data` has folders of datasets; without it only the demo's
data and simulated ground are asked. Numbers are compared bit for bit, seconds and times of day
are not compared. Exit code 1 if anything differs.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

METHODS = ("gradient", "smoothed", "paper")
NOT_COMPARED = {"seconds", "versions", "created", "time", "wall_seconds"}
"""Keys of JSON whose values differ from run to run."""


@dataclass(frozen=True)
class Case:
    """A command line: `{data}` is a dataset, `{out}` a folder of its own."""

    name: str
    words: tuple[str, ...]


def cases_of(dataset: Path, quick: bool) -> Iterator[Case]:
    """Give the verbs that a dataset is asked by."""
    data, name = str(dataset), dataset.name
    for method in METHODS:
        out = "{out}/closures.json"
        words = ("detect", data, "--out", out, "--method", method, "--cache", "none", "--json")
        yield Case(f"{name} detect {method}", words)
        if quick:
            return
    yield Case(f"{name} slam", ("slam", data, "--out", "{out}/slam", "--cache", "none"))
    yield Case(f"{name} fit", ("fit", data, "--out", "{out}/fitted.toml"))
    cloud = sorted((dataset / "submaps").iterdir())[0]
    yield Case(f"{name} map", ("map", str(cloud), "--out", "{out}/map.npz"))
    if (dataset / "poses_gt.txt").exists():
        words = ("evaluate", data, "--out", "{out}/report", "--cache", "none")
        yield Case(f"{name} evaluate", words)


def write(case: Case, tree: Path, out: Path) -> None:
    """Run a case with a tree's code; what it prints is a file among the others."""
    out.mkdir(parents=True)
    words = [word.replace("{out}", ".") for word in case.words]
    ended = subprocess.run(
        [sys.executable, "-m", "app", *words],
        cwd=out,
        env=os.environ | {"PYTHONPATH": str(tree.resolve())},
        capture_output=True,
        text=True,
        check=False,
    )
    (out / "printed.txt").write_text(f"exit {ended.returncode}\n{ended.stdout}{ended.stderr}")


def comparable(path: Path) -> object:
    """Give a file's content without what differs from run to run."""
    if path.suffix == ".json":
        return without_times(json.loads(path.read_text(encoding="utf-8")))
    if path.suffix in {".npz", ".zip"}:
        archive = zipfile.ZipFile(path)
        return {name: archive.read(name) for name in archive.namelist()}
    if path.suffix in {".txt", ".md", ".html", ".toml", ".svg", ".g2o", ".csv"}:
        text = path.read_text(encoding="utf-8")
        text = re.sub(r"\d{4}-\d\d-\d\d[T ][\d:.]+(\+\d\d:\d\d|Z)?", "DAY", text)
        text = re.sub(r"(\"(?:seconds|versions)\": ?)(\{[^}]*\}|[\d.e-]+)", r"\1…", text)
        text = re.sub(r'(?m)^.*"event":"progress".*\n', "", text)
        text = re.sub(r"(\| maps .*\n.*\n)(\|.*\n)+", r"\1", text)  # the report's table of seconds
        return re.sub(r"\b\d+(\.\d+)? ?(s|ms|min|MB)\b", "SECONDS", text)
    return path.read_bytes()


def without_times(value: object) -> object:
    """Leave out the keys of `NOT_COMPARED`, however deep."""
    if isinstance(value, dict):
        return {key: without_times(v) for key, v in value.items() if key not in NOT_COMPARED}
    if isinstance(value, list):
        return [without_times(item) for item in value]
    return value


def differences(before: Path, now: Path) -> list[str]:
    """Name the files of two folders that are in one alone, or differ."""
    names = {p.relative_to(f) for f in (before, now) for p in f.rglob("*") if p.is_file()}
    found: list[str] = []
    for name in sorted(names):
        missing = [folder for folder in (before, now) if not (folder / name).exists()]
        if missing:
            found.append(f"{name}: not written {'before' if missing == [before] else 'now'}")
        elif comparable(before / name) != comparable(now / name):
            found.append(f"{name}: differs")
    return found


def main() -> int:
    """Run all cases by both trees, one after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", type=Path, required=True, help="the tree to compare with")
    parser.add_argument("--now", type=Path, default=Path(), help="the tree that was changed")
    parser.add_argument("--data", type=Path, nargs="*", default=[], help="datasets")
    parser.add_argument("--keep", type=Path, help="keep the written files in this folder")
    parser.add_argument("--quick", action="store_true", help="detect by the first method alone")
    given = parser.parse_args()
    folder = given.keep or Path(tempfile.mkdtemp(prefix="rewrite-"))
    demo = given.now / "assets" / "demo"
    failed = 0
    for dataset in [demo, *given.data]:
        for case in cases_of(dataset.resolve(), given.quick):
            outs = [folder / which / case.name.replace(" ", "-") for which in ("before", "now")]
            for tree, out in zip((given.before, given.now), outs, strict=True):
                if not out.exists() or tree is given.now:
                    shutil.rmtree(out, ignore_errors=True)
                    write(case, tree, out)
            found = differences(*outs)
            failed += bool(found)
            print(f"{case.name}: {'; '.join(found) or 'the same'}", flush=True)
    if given.keep is None:
        shutil.rmtree(folder)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
