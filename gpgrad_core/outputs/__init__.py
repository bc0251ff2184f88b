"""Files that other programs read: loop closures, maps, fitted parameters."""

from gpgrad_core.outputs.closure_table import write_closure_table
from gpgrad_core.outputs.closures import (
    ClosureReport,
    PairRecord,
    read_closures,
    report_closures,
    restore_closures,
    write_closures,
)
from gpgrad_core.outputs.files import check_output, replacing
from gpgrad_core.outputs.fitted import write_fitted
from gpgrad_core.outputs.maps import MAP_ENDINGS, write_map

__all__ = [
    "MAP_ENDINGS",
    "ClosureReport",
    "PairRecord",
    "check_output",
    "read_closures",
    "replacing",
    "report_closures",
    "restore_closures",
    "write_closure_table",
    "write_closures",
    "write_fitted",
    "write_map",
]
