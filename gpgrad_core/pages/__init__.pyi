from .notebook import Inline, show
from .page import PAGE, page_of_dataset, page_of_pair, write_page
from .subject import PageData, subject_of, subject_of_map

__all__ = [
    "PAGE",
    "Inline",
    "PageData",
    "page_of_dataset",
    "page_of_pair",
    "show",
    "subject_of",
    "subject_of_map",
    "write_page",
]
