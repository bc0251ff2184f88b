"""The faults that are put in by hand still fit the code."""

import pytest

from tests.long.mutations.__main__ import ROOT, Fault, read_faults


@pytest.mark.parametrize("fault", read_faults(["*"]), ids=lambda fault: fault.name)
def test_a_fault_changes_the_code(fault: Fault) -> None:
    fault.changed(ROOT)
    assert all((ROOT / test).exists() for test in fault.tests)
