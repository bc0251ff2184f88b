from .closure_writer import ClosureWriter, write_closure_table, write_closures
from .closures import (
    LONGEST_NOTE,
    ClosureReport,
    Decision,
    PairRecord,
    closure_of,
    count_images,
    read_closures,
    read_pair,
    record_of,
    report_closures,
    restore_closures,
    table_of,
)
from .files import check_apart, check_output, replacing
from .fitted import fitted_rows, write_fitted, write_fitted_table
from .maps import MAP_ENDINGS, write_map
from .shortlists import read_shortlist, resume_shortlist, write_shortlist

__all__ = [
    "LONGEST_NOTE",
    "MAP_ENDINGS",
    "ClosureReport",
    "ClosureWriter",
    "Decision",
    "PairRecord",
    "check_apart",
    "check_output",
    "closure_of",
    "count_images",
    "fitted_rows",
    "read_closures",
    "read_pair",
    "read_shortlist",
    "record_of",
    "replacing",
    "report_closures",
    "restore_closures",
    "resume_shortlist",
    "table_of",
    "write_closure_table",
    "write_closures",
    "write_fitted",
    "write_fitted_table",
    "write_map",
    "write_shortlist",
]
