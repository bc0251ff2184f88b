"""What runs in the pages, scripts and styles: each is a file, and this is how Python reads it."""

import json
import re
from functools import cache
from importlib.resources import files


@cache
def read_page_file(name: str) -> str:
    """Read a file of this folder, such as ``bridge.js`` or ``look.css``."""
    return files(__name__).joinpath(name).read_text(encoding="utf-8")


def fill_page_file(name: str, **values: object) -> str:
    """Read a file of this folder and put values in the place of the names that stand for them.

    Args:
        name: Of the file.
        values: By name, in upper case; anything that JSON can hold.
    """
    text = read_page_file(name)
    for place, value in values.items():
        text = re.sub(rf"\b{place}\b", lambda _, value=value: json.dumps(value), text)
    return text
