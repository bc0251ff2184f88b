"""Makes the guide's pictures of the paper's figures.

Run as ``python -m tests.long.pictures.make_figures``.
"""

import contextlib
import re
import shlex
import sys
import tempfile
from pathlib import Path

from PIL import Image

from app.cli import run
from gpgrad_core.simulation.demo import demo_path

ASSETS = Path(__file__).resolve().parents[3] / "assets"
MOST_WIDE, MAX_BYTES = 1100, 120_000


def commands() -> list[list[str]]:
    """Read the commands in the guide."""
    page = (ASSETS / "guide" / "reproduce.md").read_text(encoding="utf-8")
    block = next(
        one for one in re.findall(r"```sh\n(.*?)```", page, re.DOTALL) if "simulate" in one
    )
    return [shlex.split(line)[1:] for line in block.splitlines()]


def shrink(figure: Path, picture: Path) -> None:
    """Save a figure small enough for a page.

    Raises:
        ValueError: If it is too large all the same.
    """
    whole = Image.open(figure).convert("RGB")
    width = min(MOST_WIDE, whole.width)
    small = whole.resize((width, whole.height * width // whole.width), Image.Resampling.LANCZOS)
    small.save(picture, quality=72, method=6)
    if picture.stat().st_size > MAX_BYTES:
        raise ValueError(f"{picture} has {picture.stat().st_size:,} bytes, more than {MAX_BYTES:,}")


def main() -> int:
    """Run the commands, and put the demo's figures and those of all datasets into the guide."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for command in commands():
            words = [str(demo_path()) if word == "assets/demo" else word for word in command]
            if code := run(words):
                return code
        for name in ("1_demo", "3_demo", "4_demo", "6", "8", "9", "10_demo"):
            number = name.partition("_")[0]
            picture = ASSETS / "pictures" / f"figure_{number}.webp"
            shrink(Path("figures", f"figure_{name}.png"), picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
