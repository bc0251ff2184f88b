"""The commands that every session has: what people do often, on a key."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import viser

from app.viewer.pair.panel import LAYER_NAMES
from app.viewer.state import LAYERS, Role, ViewOptions
from app.viewer.widgets.commands import Commands


@dataclass(frozen=True, eq=False)
class Actions:
    """What a session lets commands do.

    Attributes:
        options: Gives the view's options as they are.
        set_options: Shows others.
        step_pair: Goes to the next (1) or the previous (-1) submap as query or database.
        step_match: Points at the next (1) or the previous (-1) association.
        clear: Points at nothing.
        look_at_both: Brings the camera of a page back to both submaps.
        look_from_above: Puts the camera of a page above them, as maps are seen.
    """

    options: Callable[[], ViewOptions]
    set_options: Callable[[ViewOptions], None]
    step_pair: Callable[[Role, int], None]
    step_match: Callable[[int], None]
    clear: Callable[[], None]
    look_at_both: Callable[[viser.ClientHandle], None]
    look_from_above: Callable[[viser.ClientHandle], None]


def add_shortcuts(commands: Commands, actions: Actions) -> None:
    """Add the commands to the palette."""

    def choose(group: str, label: str, key: str | None, **changes: object) -> None:
        commands.add(
            group,
            label,
            lambda page: actions.set_options(changed(actions.options(), **changes)),  # noqa: ARG005
            key=key,
        )

    def switch(label: str, key: str | None, name: str) -> None:
        def act(page: viser.ClientHandle) -> None:
            del page
            options = actions.options()
            actions.set_options(changed(options, **{name: not getattr(options, name)}))

        commands.add("Show or hide", label, act, key=key)

    def other_layout(page: viser.ClientHandle) -> None:
        del page
        options = actions.options()
        registered = options.layout == "registered"
        actions.set_options(changed(options, layout="side by side" if registered else "registered"))

    def both(page: viser.ClientHandle) -> None:
        del page
        options = actions.options()
        # Out of the difference too: it shows neither of the two.
        layer = "elevation" if options.layer == "difference" else options.layer
        actions.set_options(changed(options, layout="registered", compare="both", layer=layer))

    commands.add("View", "Both submaps in view", actions.look_at_both, key="R")
    commands.add("View", "View from above", actions.look_from_above, key="T")
    commands.add("View", "Side by side or registered", other_layout, key="L")
    choose("Compare", "Blink: one after the other", "B", layout="registered", compare="blink")
    choose("Compare", "Swipe: left and right of a line", "V", layout="registered", compare="swipe")
    choose(
        "Compare",
        "Height difference of the registered maps",
        "X",
        layout="registered",
        compare="both",
        layer="difference",
    )
    commands.add("Compare", "Both at once", both, key="Z")
    commands.add("Match", "Next match", lambda page: actions.step_match(1), key="N")  # noqa: ARG005
    commands.add(
        "Match",
        "Previous match",
        lambda page: actions.step_match(-1),  # noqa: ARG005
        key="P",
    )
    commands.add(
        "Match",
        "Point at no match and no place",
        lambda page: actions.clear(),  # noqa: ARG005
        key="U",
    )
    _add_pairs(commands, actions)
    switch("Inlier lines", "I", "inlier_lines")
    switch("Outlier lines", "O", "outlier_lines")
    switch("Keypoints", "K", "keypoints")
    switch("Point clouds", "C", "clouds")
    switch("Surfaces", None, "surfaces")
    switch("Hillshade", None, "hillshade")
    for number, layer in enumerate(LAYERS, start=1):
        choose("Layer", LAYER_NAMES[layer].capitalize(), str(number), layer=layer)


def _add_pairs(commands: Commands, actions: Actions) -> None:
    """Add the steps through the submaps."""

    def add(role: Role, step: int, key: str, modifier: str | None) -> None:
        commands.add(
            "Pair",
            f"{'Next' if step > 0 else 'Previous'} {role}",
            lambda page: actions.step_pair(role, step),  # noqa: ARG005
            key=key,
            modifier=modifier,
        )

    add("query", 1, "J", None)
    add("query", -1, "J", "shift")
    add("database", 1, "M", None)
    add("database", -1, "M", "shift")


def changed(options: ViewOptions, **changes: object) -> ViewOptions:
    """Copy options with some of them changed; what a command shows is switched on to be seen."""
    if "layer" in changes:
        changes = {"surfaces": True} | changes
    return replace(options, **changes)
