from .closure_table import write_closure_table
from .closure_writer import ClosureWriter, write_closures
from .closures import (
    ClosureReport,
    PairRecord,
    read_closures,
    report_closures,
    restore_closures,
)
from .files import check_apart, check_output, replacing
from .fitted import write_fitted
from .maps import MAP_ENDINGS, write_map
from .shortlists import read_shortlist, resume_shortlist, write_shortlist

__all__ = [
    "MAP_ENDINGS",
    "ClosureReport",
    "ClosureWriter",
    "PairRecord",
    "check_apart",
    "check_output",
    "read_closures",
    "read_shortlist",
    "replacing",
    "report_closures",
    "restore_closures",
    "resume_shortlist",
    "write_closure_table",
    "write_closures",
    "write_fitted",
    "write_map",
    "write_shortlist",
]
