"""What is drawn: layer, colours and their legend, layout, associations."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import viser

from app.viewer.draw.layers import Scale
from app.viewer.host import Host
from app.viewer.state import (
    COLOR_MAPS,
    COMPARE,
    LAYERS,
    LAYOUTS,
    UNTRUSTED,
    Compare,
    Layer,
    ViewOptions,
)
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.legend import legend_html
from app.viewer.widgets.numbers import Numbers
from gpgrad_core.params.fields import bounds_of

LAYER_NAMES: dict[Layer, str] = {
    "elevation": "elevation",
    "std": "standard deviation",
    "gradient": "gradient",
    "slope_x": "dz/dx",
    "slope_y": "dz/dy",
    "mask": "mask",
    "difference": "height difference",
    "agreement": "agreement",
}
COMPARE_NAMES: dict[Compare, str] = {
    "both": "both",
    "query": "query only",
    "database": "database only",
    "swipe": "swipe",
    "blink": "blink",
}


class ViewPanel:
    """Widgets for each of the view's options; reports the whole new options."""

    def __init__(
        self,
        host: Host,
        options: ViewOptions,
        on_change: Callable[[ViewOptions], None],
        on_reset_camera: Callable[[], None],
        numbers: Numbers | None = None,
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            options: What they start at.
            on_change: Given the whole new options after each change by a user.
            on_reset_camera: Called when the user asks for the view of both submaps.
            numbers: Takes what is typed beside the sliders.
        """
        gui = host.gui
        self._numbers = numbers
        self._options = options
        self._on_change = on_change
        self._inputs: dict[str, tuple[viser.GuiInputHandle[Any], Callable[[Any], object]]] = {}
        self._bind(
            "layout",
            gui.add_dropdown(
                "Layout",
                LAYOUTS,
                initial_value=options.layout,
                hint="Each submap by itself, or the query laid onto the database as the "
                "registration says, or the gradient of each from above: there the cursor shows "
                "the same place in both.",
            ),
        )
        self._bind_choice(
            "compare",
            gui.add_dropdown(
                "Compare",
                tuple(COMPARE_NAMES[compare] for compare in COMPARE),
                initial_value=COMPARE_NAMES[options.compare],
                hint="How to compare registered submaps: both at once, one alone, the query "
                "left and the database right of a line, or one after the other.",
            ),
            COMPARE_NAMES,
        )
        self._bind(
            "swipe",
            gui.add_slider(
                "Swipe",
                0.0,
                1.0,
                0.01,
                options.swipe,
                hint="Position of the line: the query is left of it, the database right.",
            ),
        )
        self._bind_choice(
            "layer",
            gui.add_dropdown(
                "Layer",
                tuple(LAYER_NAMES[layer] for layer in LAYERS),
                initial_value=LAYER_NAMES[options.layer],
                hint="What the colours show. The height difference is query minus database after "
                "registration. Agreement is blue where the heights speak for one terrain, and red "
                "where they speak against it. Both are grey where only one of them saw the ground.",
            ),
            LAYER_NAMES,
        )
        self._bind(
            "color_map",
            gui.add_dropdown(
                "Colours",
                COLOR_MAPS,
                initial_value=options.color_map,
                hint="Colour map of the layer. Automatic chooses one that suits it.",
            ),
        )
        self._legend = gui.add_html("")
        self._bind(
            "surfaces",
            gui.add_checkbox(
                "Surfaces",
                options.surfaces,
                hint="Gaussian-process surfaces, inferred from the points.",
            ),
        )
        self._bind(
            "clouds",
            gui.add_checkbox(
                "Point clouds",
                options.clouds,
                hint="The measured points of the query (blue) and of the database (orange).",
            ),
        )
        self._bind(
            "keypoints",
            gui.add_checkbox(
                "Keypoints",
                options.keypoints,
                hint="Inliers are green (yellow if the pair is refused), outliers are red, and "
                "keypoints without an association are grey.",
            ),
        )
        self._bind(
            "inlier_lines",
            gui.add_checkbox(
                "Inlier lines",
                options.inlier_lines,
                hint="Associations that agree with the registration (green).",
            ),
        )
        self._bind(
            "outlier_lines",
            gui.add_checkbox(
                "Outlier lines",
                options.outlier_lines,
                hint="Associations that do not agree with it (red).",
            ),
        )
        self._bind(
            "all_lines",
            gui.add_checkbox(
                "All lines",
                options.all_lines,
                hint="Draws a line for every association. Otherwise at most forty of each kind are "
                "drawn, spread over the ground.",
            ),
        )
        camera = gui.add_button("Show both submaps", hint="Moves the camera back to both submaps.")
        with gui.add_folder("More view options", expand_by_default=False):
            self._bind(
                "untrusted",
                gui.add_dropdown(
                    "Masked cells",
                    UNTRUSTED,
                    initial_value=options.untrusted,
                    hint="What to do with cells that the variance mask rejects.",
                ),
            )
            self._bind(
                "hillshade",
                gui.add_checkbox(
                    "Hillshade",
                    options.hillshade,
                    hint="Lights the elevation from the upper left. Without it the colours are "
                    "exactly those of the legend.",
                ),
            )
            self._bind(
                "point_size",
                gui.add_slider(
                    "Point size [m]",
                    0.005,
                    0.2,
                    0.005,
                    options.point_size,
                    hint="Size of a point of the point clouds.",
                ),
            )
            self._bind(
                "dark",
                gui.add_checkbox("Dark", options.dark, hint="Light text on a dark page."),
            )

        self._show_what_applies()

        on_press(camera, on_reset_camera)

    @property
    def options(self) -> ViewOptions:
        """The options as the widgets show them."""
        return self._options

    def set(self, options: ViewOptions) -> None:
        """Show other options; ``on_change`` is not called."""
        self._options = options
        for name, (handle, shown) in self._inputs.items():
            handle.value = shown(getattr(options, name))
        self._show_what_applies()

    def show_legend(self, scale: Scale | None, histogram: str = "", note: str = "") -> None:
        """Show what the colours mean; None shows none, for there is nothing coloured.

        Args:
            scale: Of the colours.
            histogram: Picture of how often each value occurs, as HTML.
            note: A line about it.
        """
        self._legend.content = legend_html(scale, histogram=histogram, note=note)

    def _bind(
        self,
        name: str,
        handle: viser.GuiInputHandle[Any],
        convert: Callable[[Any], object] = lambda value: value,
        shown: Callable[[Any], object] = lambda value: value,
    ) -> None:
        self._inputs[name] = handle, shown

        def change(value: Any) -> None:
            self._options = replace(self._options, **{name: convert(value)})
            self._show_what_applies()
            self._on_change(self._options)

        def take(number: float) -> None:
            change(number)
            handle.value = number

        if self._numbers is not None and isinstance(handle, viser.GuiSliderHandle):
            self._numbers.add(handle, bounds_of(ViewOptions)[name], take)
        on_choice(handle, change)

    def _bind_choice(
        self, name: str, handle: viser.GuiInputHandle[str], names: Mapping[Any, str]
    ) -> None:
        """Bind a choice whose values have names for people."""
        values = {text: value for value, text in names.items()}
        self._bind(name, handle, values.__getitem__, names.__getitem__)

    def _show_what_applies(self) -> None:
        registered = self._options.layout == "registered"
        self._inputs["compare"][0].visible = registered
        self._inputs["swipe"][0].visible = registered and self._options.compare == "swipe"
