"""The soak in short: four minutes, on a machine that has nothing else to do.

An hour is `python -m tests.long.soak --minutes 60`.
"""

from tests.long.soak.__main__ import soak

MINUTES = 4.0


def test_a_viewer_in_use_neither_grows_nor_lags_behind() -> None:
    report = soak(MINUTES, seed=1, memory="1GB", every=30.0)
    print(f"\n{report.text()}")
    assert report.stale == []
    assert report.errors == []
    assert report.num_checks >= 2
    for viewer in report.viewers:
        # The first minute fills the memory; an hour shows that it stays so.
        assert viewer.around(1.0)["memory"] <= 1100.0
        assert viewer.around(1.0)["threads"] <= 1.1 * viewer.around(0.5)["threads"] + 5
        assert viewer.around(1.0)["descriptors"] <= viewer.around(0.5)["descriptors"] + 3
