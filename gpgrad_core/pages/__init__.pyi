from .notebook import Inline, show
from .page import Subject, page_of_dataset, page_of_pair, write_page

__all__ = ["Inline", "Subject", "page_of_dataset", "page_of_pair", "show", "write_page"]
