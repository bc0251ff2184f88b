"""Undo and redo: the values that something had, one of them the present one."""

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

T = TypeVar("T")

LONGEST = 200
"""Values remembered; the oldest are forgotten first."""


@dataclass(frozen=True)
class History(Generic[T]):
    """The values that were settled on, in order; the functions return a changed copy."""

    present: T
    past: tuple[T, ...] = ()  # the newest last
    future: tuple[T, ...] = ()  # the next to be redone last

    def push(self, value: T) -> "History[T]":
        """Settle on a value; what was undone before is forgotten. The present one changes nothing.

        >>> History(1).push(2).push(2).undo()
        History(present=1, past=(), future=(2,))
        """
        if value == self.present:
            return self
        return History(value, (*self.past, self.present)[-LONGEST:])

    def undo(self) -> "History[T]":
        """Go back by one; the first stays."""
        if not self.past:
            return self
        return replace(
            self, present=self.past[-1], past=self.past[:-1], future=(*self.future, self.present)
        )

    def redo(self) -> "History[T]":
        """Take back an undo; the last stays."""
        if not self.future:
            return self
        return replace(
            self, present=self.future[-1], past=(*self.past, self.present), future=self.future[:-1]
        )
