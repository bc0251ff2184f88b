from .notebook import Inline, show
from .page import (
    PAGE,
    OutlinedSubmap,
    Subject,
    dataset_figures,
    judge,
    page_of_dataset,
    page_of_pair,
    subject_of,
    subject_of_map,
    write_page,
)

__all__ = [
    "PAGE",
    "Inline",
    "OutlinedSubmap",
    "Subject",
    "dataset_figures",
    "judge",
    "page_of_dataset",
    "page_of_pair",
    "show",
    "subject_of",
    "subject_of_map",
    "write_page",
]
