"""Dependencies point one way, and every module has its place."""

import ast
import importlib
import re
import shutil
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


PLANTED = {
    ("gpgrad_core/matching.py", "gpgrad_core.registration"): "core layers",
    ("gpgrad_core/recordings/voxels.py", "gpgrad_core.recordings.build"): "recordings layers",
    ("gpgrad_core/types.py", "viser"): "the core knows neither the app",
    ("app/viewer/features/pairs/all_pairs.py", "app.viewer.features.data.tab"): "features of the",
    ("app/viewer/features/nudge.py", "app.viewer.features.pair.scene"): "features of the",
    ("app/viewer/features/desk.py", "app.viewer.features.pair"): "what features of the",
    ("app/viewer/features/pair/panel.py", "app.viewer.features.pair.scene"): "panels know no",
}
"""A module, what it must not import, and the contract that says so."""


def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    """Check the contracts of the packages in a folder."""
    return subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as l; l()"],
        capture_output=True,
        text=True,
        cwd=folder,
        check=False,
    )


def test_import_contracts_hold() -> None:
    finished = lint_imports(ROOT)
    assert finished.returncode == 0, finished.stdout + finished.stderr


@pytest.mark.slow
def test_a_wrong_import_breaks_its_contract(tmp_path: Path) -> None:
    for package in ("app", "gpgrad_core"):
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for name, wrong in PLANTED:
        module = tmp_path / name
        if module.suffix != ".py":  # be it a module or a package
            module = module / "__init__.py" if module.is_dir() else module.with_suffix(".py")
        module.write_text(
            f"{module.read_text(encoding='utf-8')}\nimport {wrong}\n", encoding="utf-8"
        )
    finished = lint_imports(tmp_path)
    assert finished.returncode == 1, finished.stdout + finished.stderr
    broken = [line for line in finished.stdout.splitlines() if " BROKEN" in line]
    contracts = set(PLANTED.values())
    assert len(broken) == len(contracts), broken
    for contract in contracts:
        assert sum(line.startswith(contract) for line in broken) == 1, contract
    for name, wrong in PLANTED:
        importer = name.removesuffix(".py").replace("/", ".")
        assert f"{importer} -> {wrong} " in finished.stdout, (importer, wrong)


@pytest.mark.slow
def test_what_no_change_runs_can_be_loaded() -> None:
    """A parameter was renamed, and for days nobody saw that a test of quality had the old name."""
    for path in sorted((ROOT / "tests" / "long").rglob("*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        try:
            importlib.import_module(name)
        except ModuleNotFoundError as error:
            if (error.name or "").split(".")[0] in ("app", "gpgrad_core", "tests"):
                raise  # others are of extras


def test_the_top_level_holds_nothing_else() -> None:
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout: nothing says which files belong to the project")
    if shutil.which("git") is None:
        pytest.skip("git is not installed: nothing says which files belong to the project")
    tracked = subprocess.run(
        ["git", "ls-files"], capture_output=True, text=True, cwd=ROOT, check=True
    ).stdout.splitlines()
    top = {name.split("/")[0] for name in tracked}
    visible = {name for name in top if not name.startswith(".")}
    assert visible <= {
        *("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff"),
        *("app", "gpgrad_core", "tests", "assets"),
    }


@pytest.mark.slow
def test_no_pattern_is_possessive() -> None:
    """Before Python 3.11.5 such patterns match what they should not, and Debian 12 has 3.11.2."""
    texts = [
        text.value if isinstance(text.value, str) else text.value.decode()
        for package in ("app", "gpgrad_core", ".ci")
        for path in sorted((ROOT / package).rglob("*.py"))
        for call in nodes(path)
        if isinstance(call, ast.Call) and call.args and isinstance(call.func, ast.Attribute)
        if isinstance(call.func.value, ast.Name) and call.func.value.id == "re"
        for text in ast.walk(call.args[0])
        if isinstance(text, ast.Constant) and isinstance(text.value, str | bytes)
    ]
    assert texts
    assert not [text for text in texts if re.search(r"[*+?}]\+|\(\?>", text)]


@pytest.mark.slow
def test_what_is_imported_is_declared() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = {re.split(r"[<>=\[]", entry)[0] for entry in project["dependencies"]}
    spelled = {"opencv-contrib-python-headless": "cv2", "pillow": "PIL"}
    names = {spelled.get(name, name.replace("-", "_")) for name in declared}
    allowed = names | {"app", "gpgrad_core"}
    optional = {"lazrs"}  # asked for by name where a file needs it
    for package in ("app", "gpgrad_core"):
        for path in (ROOT / package).rglob("*.py"):
            for name in imported(path) - sys.stdlib_module_names - optional:
                assert name in allowed, f"{path}: {name} is not in pyproject.toml"


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Everything that a module is written of."""
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def imported(path: Path) -> set[str]:
    """Top names of all that a module imports, anywhere in it."""
    names: set[str] = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.split(".")[0])
    return names
