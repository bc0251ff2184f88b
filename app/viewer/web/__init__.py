"""What runs in the pages, scripts and styles: each is a file, and this is how Python reads it.

What they depend on in viser's own pages stands in ``viser.toml``.
"""

import json
import re
import tomllib
from collections.abc import Iterable
from functools import cache
from importlib.resources import files


@cache
def _read(name: str) -> str:
    return files(__name__).joinpath(name).read_text(encoding="utf-8")


@cache
def viser_parts() -> dict[str, str]:
    """The selectors of the parts of viser's pages, by our names for them."""
    return tomllib.loads(_read("viser.toml"))["parts"]


def fill_page_file(name: str, **values: object) -> str:
    """Read a file of this folder and replace the names in it that stand for values, in upper case.

    The names of viser's parts work in every file. A script gets anything that JSON can hold, as
    JSON; a style or a piece of HTML gets the text as it is, which must be safe there.
    """
    fillings = {**viser_parts(), **values}

    def fill(match: re.Match[str]) -> str:
        if match[0] not in fillings:
            return match[0]
        value = fillings[match[0]]
        return json.dumps(value) if name.endswith(".js") else str(value)

    return re.sub(r"\b[A-Z][A-Z_]+\b", fill, _read(name))


def dress(page: str, scripts: Iterable[str], body: str = "") -> str:
    """Insert our colours, scripts and styles into a page of viser's, and HTML before its content.

    Colours and scripts stand before all of viser's; our style sheet stands in the body, because
    viser's is put at the end of the head.
    """
    head = "".join(f"<script>{fill_page_file(name)}</script>" for name in scripts)
    page = page.replace("<head>", f"<head><style>{fill_page_file('palette.css')}</style>{head}", 1)
    start, end = page.rsplit("<body>", 1)
    return f"{start}<body><style>{fill_page_file('look.css')}</style>{body}{end}"
