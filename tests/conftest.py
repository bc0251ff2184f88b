"""What all tests share: how thorough they are, bytecode, reruns, and the real datasets.

Importing this file switches the shape checks on or off. pytest imports it before any test module.
"""

import gc
import os
import sys
import tempfile
from collections.abc import Generator, Iterator

# The test processes share the processors. NumPy reads this when it is loaded, so it is set before.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from pathlib import Path

import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

# Without bytecode, every test process and each of the many commands under test would compile all
# modules anew, and pytest would rewrite all assertions: half of the time of the collection.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

THOROUGH = os.environ.get("GPGRAD_THOROUGH") == "1"
"""Array shapes are checked, and laws are tried with many examples: in CI, not by default."""

# Only packages with arrays are checked. The checks take a third of a call's time. The option makes
# beartype accept an int for a float, as PEP 484 does.
if THOROUGH:
    install_import_hook(
        ["gpgrad_core", "app.viewer"],
        "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))",
    )

# There is no deadline, because the time of an example depends mostly on the machine's load. A
# failed run can be repeated on its machine, but other machines draw other examples: Hypothesis also
# draws constants from the modules that are loaded, and changes with its releases. So a law must
# hold for every example, and an example that must always be tried belongs into an @example.
# GPGRAD_EXPLORE=1 draws new examples. A law that needs many examples asks for them itself.
settings.register_profile("repeat", deadline=None, derandomize=True, max_examples=20)
settings.register_profile("thorough", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile(
    "explore" if os.environ.get("GPGRAD_EXPLORE") == "1" else "thorough" if THOROUGH else "repeat"
)

CACHE = pytest.StashKey[tempfile.TemporaryDirectory[str]]()


def pytest_configure(config: pytest.Config) -> None:
    """Give the tests and their processes a cache folder of their own, so that they share fits."""
    if not hasattr(config, "workerinput"):  # the workers inherit it
        config.stash[CACHE] = tempfile.TemporaryDirectory(prefix="gpgrad-tests-")
        os.environ["XDG_CACHE_HOME"] = config.stash[CACHE].name


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove it."""
    if CACHE in config.stash:
        config.stash[CACHE].cleanup()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for no garbage while modules are imported, which stay: a quarter of the time of it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let what drives a browser run once more if it fails; the end of the run tells of it."""
    for item in items:
        if item.get_closest_marker("browser"):
            item.add_marker(pytest.mark.flaky(reruns=1))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say which tests failed before they passed."""
    for report in terminalreporter.stats.get("rerun", []):
        crash = getattr(report.longrepr, "reprcrash", None)
        said = (str(crash.message if crash else report.longrepr).splitlines() or ["nothing"])[0]
        terminalreporter.write_line(
            f"TO BE MENDED: {report.nodeid} failed, and was run once more. It said: {said}",
            red=True,
        )


ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the real datasets, which are not part of the project."""
    folder = Path(os.environ.get("GPGRAD_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real datasets at {folder}: set GPGRAD_DATA to a folder that holds them")
    return folder


@pytest.fixture
def server() -> Iterator[object]:
    """Start a viewer's server on a free port, without a browser."""
    from tests.support.server import started_server  # noqa: PLC0415 - for the tests of the app alone

    with started_server() as made:
        yield made
