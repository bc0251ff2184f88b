from .notebook import Inline, show
from .page import (
    PAGE,
    OutlinedSubmap,
    Subject,
    corrected,
    dataset_figures,
    page_of_dataset,
    page_of_pair,
    write_page,
)

__all__ = [
    "PAGE",
    "Inline",
    "OutlinedSubmap",
    "Subject",
    "corrected",
    "dataset_figures",
    "page_of_dataset",
    "page_of_pair",
    "show",
    "write_page",
]
