"""The picture: pure conversions to positions and colours, and the scene that shows them."""
