"""The parameters: sliders, presets, undo, and the fit of the terrain's parameters."""
