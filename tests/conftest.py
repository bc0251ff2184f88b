"""What every test has: checked array shapes, small data, and the real sets where they are.

Importing this file switches the shape checks on; pytest does so before any test module.
"""

import contextlib
import io
import os
from collections.abc import Iterator

# Two test processes share two processors; set before NumPy is loaded, which reads it then.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from pathlib import Path

import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

# Where the arrays are; checks cost a third of the time that a call takes, so that what is timed
# (tests/quality) is timed with GPGRAD_SHAPE_CHECKS=0.
# An int where a float is annotated is what Python means by it (PEP 484), and beartype does not.
if os.environ.get("GPGRAD_SHAPE_CHECKS", "1") == "1":
    install_import_hook(
        ["gpgrad_core", "app.viewer"],
        "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))",
    )

# How long an example takes says more about the machine's load than about the law. A red run can be
# repeated on its machine, but other machines draw other examples: Hypothesis also draws constants
# from the modules that are loaded, and changes with its releases. So a law must hold for every
# example, and one that must be tried everywhere stands in an @example. GPGRAD_EXPLORE=1 draws anew.
settings.register_profile("repeat", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile("explore" if os.environ.get("GPGRAD_EXPLORE") == "1" else "repeat")

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
    """A viewer's server on a free port, without a browser."""
    import viser  # noqa: PLC0415 - for the tests of the app alone

    with contextlib.redirect_stdout(io.StringIO()):
        made = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        yield made
        made.stop()
