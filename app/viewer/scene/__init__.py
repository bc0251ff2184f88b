"""From numbers to the picture: colours, layers, surfels, lines, cameras; pure, but for `nodes`."""
