"""The commands of the pair: keys for what people do often."""

from collections.abc import Callable
from dataclasses import replace

from app.viewer.draw.cameras import set_view
from app.viewer.feature import Desk, Frame
from app.viewer.pair.panel import LAYER_NAMES
from app.viewer.pair.tab import PairTab
from app.viewer.state import COMPARED, FROM_ABOVE, LAYERS, Role, ViewOptions, registered
from app.viewer.widgets.commands import Commands


def add_shortcuts(
    commands: Commands,
    desk: Desk,
    pair: PairTab,
    frame: Frame,
    step_match: Callable[[int], None],
) -> None:
    """Add the commands to the palette.

    Args:
        commands: The palette.
        desk: Of the session.
        pair: Whose submaps are stepped through.
        frame: Brings cameras to all that is shown.
        step_match: Points at the next (1) or the previous (-1) association.
    """

    def show(**changes: object) -> None:
        desk.change(options=changed(desk.state.options, **changes))

    def choose(group: str, label: str, key: str | None, **changes: object) -> None:
        commands.add(group, label, lambda: show(**changes), key=key)

    def switch(label: str, key: str | None, name: str) -> None:
        commands.add(
            "Show or hide",
            label,
            lambda: show(**{name: not getattr(desk.state.options, name)}),
            key=key,
        )

    def other_layout() -> None:
        is_registered = desk.state.options.layout == "registered"
        show(layout="side by side" if is_registered else "registered")

    def both() -> None:
        options = registered(desk.state.options)
        # Out of what compares them too: it shows neither of the two.
        layer = "elevation" if options.layer in COMPARED else options.layer
        desk.change(options=changed(options, layer=layer))

    commands.add_for_page(
        "View",
        "All of it in view",
        frame,
        key="R",
    )
    commands.add_for_page(
        "View",
        "View from above",
        lambda page: set_view(page, pair.scene.camera_above(desk.state, desk.canvases.of(page))),
        key="T",
    )
    commands.add("View", "Side by side or registered", other_layout, key="L")
    choose("View", "Gradient of both from above", None, layout=FROM_ABOVE)
    choose("Compare", "Blink: one after the other", "B", layout="registered", compare="blink")
    choose("Compare", "Swipe: left and right of a line", "V", layout="registered", compare="swipe")
    choose(
        "Compare",
        "Height difference of the registered maps",
        "Y",
        layout="registered",
        compare="both",
        layer="difference",
    )
    choose(
        "Compare",
        "Agreement of the registered maps",
        None,
        layout="registered",
        compare="both",
        layer="agreement",
    )
    commands.add("Compare", "Both at once", both, key="Z")
    commands.add("Association", "Next association", lambda: step_match(1), key="N")
    commands.add("Association", "Previous association", lambda: step_match(-1), key="P")
    commands.add(
        "Association",
        "Choose no association and no place",
        lambda: desk.change(match=0, probe=None),
        key="U",
    )
    _add_pairs(commands, pair)
    switch("Inlier lines", "I", "inlier_lines")
    switch("Outlier lines", "O", "outlier_lines")
    switch("All lines, or forty of each kind", "G", "all_lines")
    switch("Keypoints", "K", "keypoints")
    switch("Point clouds", "C", "clouds")
    switch("Surfaces", None, "surfaces")
    switch("Hillshade", None, "hillshade")
    for number, layer in enumerate(LAYERS, start=1):
        choose("Layer", LAYER_NAMES[layer].capitalize(), str(number), layer=layer)


def _add_pairs(commands: Commands, pair: PairTab) -> None:
    """Add the steps through the submaps."""

    def add(role: Role, step: int, key: str, modifier: str | None) -> None:
        commands.add(
            "Pair",
            f"{'Next' if step > 0 else 'Previous'} {role}",
            lambda: pair.step(role, step),
            key=key,
            modifier=modifier,
        )

    add("query", 1, "J", None)
    add("query", -1, "J", "shift")
    add("database", 1, "M", None)
    add("database", -1, "M", "shift")


def changed(options: ViewOptions, **changes: object) -> ViewOptions:
    """Copy options with some of them changed; a layer also switches the surfaces on."""
    if "layer" in changes:
        changes = {"surfaces": True} | changes
    return replace(options, **changes)
