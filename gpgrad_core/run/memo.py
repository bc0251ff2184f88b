"""Results of stages, kept by their inputs and limited to a number of bytes."""

import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import fields, is_dataclass
from typing import ParamSpec, TypeVar, cast

import numpy as np

from gpgrad_core.run.store import Store

P = ParamSpec("P")
R = TypeVar("R")


class Memo:
    """Remembers ``function(*arguments)`` by (function, params, keys of inputs).

    No array is hashed. A submap has a ``fingerprint``; the result of a stage is known by the key
    under which it was made, as long as it lives; parameters are their own key. So a changed
    parameter runs only the later stages, and changing it back runs none. A stage that fails or is
    cancelled stores nothing. The same key gives the same object, so that a drawing can be skipped
    by identity.

    Threads can share a memo. If two threads ask for the same new key at the same time, both may
    compute it, and both get the first result.
    """

    def __init__(self, max_bytes: int = 2_000_000_000, store: Store | None = None) -> None:
        """Make an empty memo.

        Args:
            max_bytes: Bytes of arrays to keep; the least recently used results are dropped first.
            store: Keeps the results of `lasting` for later runs.
        """
        self._max_bytes, self.store = max_bytes, store
        self._results: OrderedDict[Hashable, tuple[object, int]] = OrderedDict()
        self._keys: weakref.WeakKeyDictionary[object, Hashable] = weakref.WeakKeyDictionary()
        self._bytes = 0
        self._lock = threading.RLock()

    def __reduce__(self) -> tuple[type["Memo"], tuple[int, Store | None]]:
        """Become an empty memo of the same size, over the same store, in another process."""
        return Memo, (self._max_bytes, self.store)

    @property
    def num_bytes(self) -> int:
        """Bytes of arrays held now."""
        return self._bytes

    def holds(self, function: Callable[..., object], *arguments: object) -> bool:
        """Whether the memo has the result for these arguments."""
        with self._lock:
            return self._key(function, arguments) in self._results

    def __call__(self, function: Callable[P, R], *arguments: P.args, **unkeyed: P.kwargs) -> R:
        """Return ``function(*arguments, **unkeyed)``, computed at most once while the memo has it.

        Args:
            function: A pure function.
            arguments: Its inputs and parameters, which make the key.
            unkeyed: Arguments that do not change the result, such as ``progress``.
        """
        with self._lock:
            key = self._key(function, arguments)
            result = self._results.get(key)
            if result is not None:
                self._results.move_to_end(key)
                return cast("R", result[0])
        return self.keep(function(*arguments, **unkeyed), function, *arguments)

    def lasting(self, function: Callable[P, R], *arguments: P.args, **unkeyed: P.kwargs) -> R:
        """As a call, but the result is also taken from the store, and kept there.

        Args:
            function: A pure function whose result `store.pack` can pack.
            arguments: Its inputs and parameters, whose text `store.key_of` can write.
            unkeyed: Arguments that do not change the result, such as ``progress``.
        """
        if self.store is None or self.holds(function, *arguments):
            return self(function, *arguments, **unkeyed)
        name = f"{function.__module__}.{function.__qualname__}"
        result = self.store(lambda: function(*arguments, **unkeyed), name, *arguments)
        return self.keep(result, function, *arguments)

    def keep(self, result: R, function: Callable[..., R], *arguments: object) -> R:
        """Store a result that was computed elsewhere; returns the one that the memo has.

        Args:
            result: What the call would return.
            function: A pure function.
            arguments: Its inputs and parameters.
        """
        with self._lock:
            key = self._key(function, arguments)
            if key in self._results:
                return cast("R", self._results[key][0])
            size = array_bytes(result)
            self._results[key] = (result, size)
            self._bytes += size
            if is_dataclass(result) and not _is_params(result):
                self._keys[result] = key
            self._drop_to(self._max_bytes, least=1)
        return result

    def drop_to(self, num_bytes: int) -> None:
        """Drop the least recently used results until no more than these bytes of arrays are held.

        What others still hold stays in memory as long as they do.
        """
        with self._lock:
            self._drop_to(num_bytes)

    def _drop_to(self, num_bytes: int, least: int = 0) -> None:
        while self._bytes > num_bytes and len(self._results) > least:
            _, (_, freed) = self._results.popitem(last=False)
            self._bytes -= freed

    def _key(self, function: Callable[..., object], arguments: tuple[object, ...]) -> Hashable:
        name = f"{function.__module__}.{function.__qualname__}"
        return name, *(self._key_of(argument) for argument in arguments)

    def _key_of(self, argument: object) -> Hashable:
        fingerprint = getattr(argument, "fingerprint", None)
        if fingerprint is not None:
            return fingerprint
        if not is_dataclass(argument) or _is_params(argument):
            return cast("Hashable", argument)  # a number, a name or parameters: its own key
        key = self._keys.get(argument)
        if key is None:
            # It was made outside this memo: a token that lives as long as it does is its key.
            key = self._keys[argument] = object()
        return key


def _is_params(value: object) -> bool:
    """Params compare by value; data (``eq=False``) by identity."""
    return type(value).__eq__ is not object.__eq__


def array_bytes(value: object) -> int:
    """Count the bytes of all arrays in a result: an array, a dataclass, a list, tuple or dict."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    if is_dataclass(value):
        return sum(array_bytes(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, dict):
        return sum(array_bytes(item) for item in value.values())
    if isinstance(value, list | tuple):
        return sum(array_bytes(item) for item in value)
    return 0
