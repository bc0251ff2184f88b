"""Packs results of stages into bytes and back: arrays, numbers, texts, tuples and dataclasses.

The bytes are a NumPy archive, so reading runs no code from the file and every part has a checksum.
Pickles would be shorter to write and unsafe to read.
"""

import importlib
import io
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, cast

import numpy as np

TREE = "tree"
"""Name of the archive's part that holds everything but the arrays, as JSON."""
PACKAGE = "gpgrad_core."
"""Only dataclasses of this package are packed and unpacked."""


class Damaged(Exception):
    """The bytes are not what was packed."""


def pack(value: object) -> bytes:
    """Pack a value.

    Args:
        value: Made of arrays, numbers, texts, None, tuples, dicts with texts as keys, and
            dataclasses of this package.

    Raises:
        TypeError: If there is something else in it.
    """
    arrays: dict[str, Any] = {}
    tree = json.dumps(_tree(value, arrays))
    out = io.BytesIO()
    parts: dict[str, Any] = {TREE: np.frombuffer(tree.encode(), np.uint8), **arrays}
    np.savez(out, **parts)
    return out.getvalue()


def unpack(data: bytes) -> object:
    """Give back what was packed; arrays are read-only.

    Raises:
        Damaged: If the bytes were changed or cut, or if a class has changed since.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            tree = json.loads(archive[TREE].tobytes())
            return _value(tree, cast("Mapping[str, Any]", archive))
    except Exception as error:  # whatever NumPy, zipfile or a class makes of damaged bytes
        raise Damaged(str(error)) from error


def _tree(value: object, arrays: dict[str, Any]) -> Any:
    """Describe a value for JSON; its arrays are put aside under names."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = cast("Any", value)
        return {"array": name}
    if isinstance(value, tuple | list):
        items = cast("tuple[object, ...]", value)
        return {"list" if isinstance(value, list) else "tuple": [_tree(i, arrays) for i in items]}
    if isinstance(value, dict):
        entries = cast("dict[str, object]", value)
        return {"dict": {key: _tree(entry, arrays) for key, entry in entries.items()}}
    kind = type(value)
    if is_dataclass(value) and kind.__module__.startswith(PACKAGE):
        given = {f.name: _tree(getattr(value, f.name), arrays) for f in fields(value) if f.init}
        return {"class": f"{kind.__module__}:{kind.__qualname__}", "fields": given}
    raise TypeError(f"a {kind.__qualname__} cannot be packed")


def _value(tree: Any, arrays: Mapping[str, Any]) -> Any:
    """Make a value from its description."""
    if not isinstance(tree, dict):
        return tree
    of: dict[str, Any] = cast("dict[str, Any]", tree)
    match next(iter(of)):
        case "array":
            array = arrays[of["array"]]
            array.setflags(write=False)
            return array
        case "list":
            return [_value(item, arrays) for item in of["list"]]
        case "tuple":
            return tuple(_value(item, arrays) for item in of["tuple"])
        case "dict":
            return {key: _value(entry, arrays) for key, entry in of["dict"].items()}
        case _:
            given = {name: _value(entry, arrays) for name, entry in of["fields"].items()}
            return _class(of["class"])(**given)


def _class(name: str) -> type:
    module, _, qualified = name.partition(":")
    if not module.startswith(PACKAGE):
        raise ValueError(f"{module} is not of this package")
    found = getattr(importlib.import_module(module), qualified)
    if not is_dataclass(found):
        raise ValueError(f"{name} is no dataclass")
    return cast("type", found)
