import re
import tomllib
from importlib.metadata import version
from pathlib import Path

from app.viewer import web
from app.viewer.web import fill_page_file, viser_parts

FOLDER = Path(web.__file__).parent
FILES = (".py", ".js", ".css", ".html")


def test_values_and_parts_of_viser_take_the_place_of_their_names() -> None:
    script = fill_page_file("numbers.js", REST_MS=60, MOST_MOVES=50, DIGITS=3)
    assert "setTimeout(rest, 60)" in script
    assert ".mantine-Slider-root" in script
    assert "VISER_" not in script
    style = fill_page_file("solid.css", UUID="u-1", SOLID="#123", SOLID_HOVER="#456")
    assert 'button[id="u-1"]' in style  # a style has no quotes around what it is given


def test_what_viser_calls_its_parts_stands_in_one_file() -> None:
    parts = viser_parts()
    texts = {path: path.read_text() for path in FOLDER.parent.rglob("*") if path.suffix in FILES}
    for path, text in texts.items():
        assert not re.search(r"mantine-[A-Z]|tabler-icon|data-dock", text), path
    used = set(re.findall(r"\bVISER_[A-Z_]+", "".join(texts.values())))
    assert used == set(parts)


def test_the_parts_are_those_of_the_viser_that_is_installed() -> None:
    told = tomllib.loads((FOLDER / "viser.toml").read_text())["version"]
    assert version("viser").split(".")[:2] == told.split(".")[:2]
