"""A list of pairs to choose from, and buttons that step through it."""

from collections.abc import Callable, Iterable

import viser

from app.viewer.server.host import Host
from app.viewer.widgets.actions import on_choice, on_step
from gpgrad_core.errors import score_in_words
from gpgrad_core.types import LoopClosure, PairOfIds

MOST_LISTED = 300
"""Longer lists make the browser slow; what is left out is counted."""


class PairList:
    """A dropdown whose first entry chooses no pair."""

    def __init__(
        self,
        host: Host,
        label: str,
        *,
        none: str,
        hint: str,
        on_choose: Callable[[PairOfIds | None], None],
    ) -> None:
        """Add the widgets; the first entry, ``none``, chooses None in place of a pair."""
        self._none = none
        self._on_choose = on_choose
        self._pairs: dict[str, PairOfIds] = {}
        self._list: viser.GuiDropdownHandle[str] = host.gui.add_dropdown(
            label, (none,), initial_value=none, hint=hint
        )
        steps = host.gui.add_button_group(
            f"Step {label.lower()}", ("previous", "next"), hint="Step through the list."
        )
        on_choice(self._list, lambda _: self._report())
        on_step(steps, self._step)

    @property
    def chosen(self) -> PairOfIds | None:
        return self._pairs.get(self._list.value)

    def offer(self, closures: Iterable[tuple[LoopClosure, str]], chosen: PairOfIds | None) -> None:
        """Fill the list with pairs, and words on each, up to `MOST_LISTED`; nothing is called."""
        pairs: dict[str, PairOfIds] = {}
        for closure, words in closures:
            score = score_in_words(closure.registration.score)
            pairs[f"{' → '.join(closure.pair)} · {score} · {words}"] = closure.pair
        self._pairs = dict(list(pairs.items())[:MOST_LISTED])
        first = self._none
        if len(pairs) > MOST_LISTED:
            first += f" (the first {MOST_LISTED} of {len(pairs):,})"
        options = (first, *self._pairs)
        if tuple(self._list.options) != options:
            self._list.options = options
        labels = [label for label, pair in self._pairs.items() if pair == chosen]
        self._list.value = labels[0] if labels else first

    def _step(self, step: int) -> None:
        labels = list(self._pairs)
        if not labels:
            return
        at = labels.index(self._list.value) + step if self.chosen is not None else 0
        self._list.value = labels[at % len(labels)]
        self._report()

    def _report(self) -> None:
        self._on_choose(self.chosen)
