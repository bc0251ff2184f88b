"""Memory that is free goes back to the system, and arrays in a file take none until used."""

import gc
import subprocess
import sys
import tempfile
import weakref
from pathlib import Path

import numpy as np
import psutil
import pytest

from gpgrad_core.run.memory import Spool, forget_pages, trim

# Freed blocks below one that is still held stay with the process, unless it gives them back.
HOARD = """
import psutil
from gpgrad_core.run.memory import give_back
blocks = [bytearray(b"x" * 100_000) for _ in range(1000)]
last = bytearray(b"x" * 100_000)
del blocks
before = psutil.Process().memory_info().rss
give_back()
print(before - psutil.Process().memory_info().rss)
"""


@pytest.mark.skipif(not trim(), reason="only the GNU C library can be told")
def test_what_was_freed_goes_back_to_the_system() -> None:
    done = subprocess.run(
        [sys.executable, "-c", HOARD], check=True, capture_output=True, text=True, timeout=60
    )
    assert int(done.stdout) > 50_000_000


def test_arrays_come_back_as_they_were_and_cannot_be_written() -> None:
    generator = np.random.default_rng(0)
    arrays = [
        generator.normal(size=(7, 3)),
        np.arange(5, dtype=np.uint8),
        np.zeros((0, 3)),
        generator.normal(size=(9, 4)).T,
        generator.normal(size=10_000),  # needs a piece of its own
        np.arange(5),
    ]
    spool = Spool()
    placed = [spool.put(array) for array in arrays]
    spool.close()
    for array, given in zip(arrays, placed, strict=True):
        np.testing.assert_array_equal(given, array)
        assert given.dtype == array.dtype
        assert not given.flags.writeable
    forget_pages()
    for array, given in zip(arrays, placed, strict=True):
        np.testing.assert_array_equal(given, array)


@pytest.mark.skipif(sys.platform == "win32", reason="counts what Unix counts")
def test_many_arrays_take_few_descriptors() -> None:
    spool, before = Spool(), psutil.Process().num_fds()
    arrays = [spool.put(np.full(1000, k)) for k in range(300)]
    assert psutil.Process().num_fds() - before < 20
    spool.close()
    assert all((array == k).all() for k, array in enumerate(arrays))


LOOKED_AT = """
import numpy as np
import psutil
from gpgrad_core.run.memory import Spool, give_back
def memory():
    return psutil.Process().memory_info().rss
spool = Spool()
array = spool.put(np.ones(60_000_000, np.uint8))
give_back()
before = memory()
total = int(array.sum(dtype=np.int64))
looked = memory()
give_back()
print(looked - before, looked - memory(), total, int(array.sum(dtype=np.int64)))
"""


@pytest.mark.slow
def test_memory_is_taken_when_they_are_looked_at_and_given_back() -> None:
    command = [sys.executable, "-c", LOOKED_AT]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60)
    taken, given, *totals = map(int, done.stdout.split())
    assert min(taken, given) > 48_000_000
    assert totals == [60_000_000] * 2


def test_the_file_has_no_name_and_goes_with_its_last_array(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    spool = Spool()
    array = spool.put(np.ones(1000, np.uint8))
    is_mapped = weakref.ref(array.base)
    assert list(tmp_path.iterdir()) == []
    spool.close()
    del spool
    gc.collect()
    assert array.sum() == 1000
    del array
    gc.collect()
    assert is_mapped() is None
