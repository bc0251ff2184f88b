"""Names that differ, made of names that may be equal."""

import re
from collections.abc import Iterable


def different_names(names: Iterable[str], before_number: str = "-") -> tuple[str, ...]:
    """Make equal names different by adding a number.

    >>> different_names(["yard", "crater", "yard"])
    ('yard', 'crater', 'yard-2')
    """
    made: list[str] = []
    for name in names:
        count, different = 1, name
        while different in made:
            count += 1
            different = f"{name}{before_number}{count}"
        made.append(different)
    return tuple(made)


def file_names(names: Iterable[str], nameless: str) -> tuple[str, ...]:
    """Make parts of file names, all different.

    >>> file_names(["a b", "a/b", "../"], "method")
    ('a_b', 'a_b_2', 'method')
    """
    plain = (re.sub(r"[^\w-]+", "_", name).strip("_") or nameless for name in names)
    return different_names(plain, "_")
