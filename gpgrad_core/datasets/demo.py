"""The built-in demo dataset: where it is."""

from pathlib import Path

from gpgrad_core.errors import InputError


def demo_path() -> Path:
    """Find the built-in demo dataset, in an installed package or in a checkout.

    Raises:
        InputError: If neither has it: the installation is not whole.
    """
    here = Path(__file__).resolve()
    places = (here.parent / "demo", here.parents[2] / "assets" / "demo")
    for place in places:
        if (place / "submaps").is_dir():
            return place
    raise InputError(f"the built-in demo is in none of {', '.join(map(str, places))}; reinstall")
