"""From a submap to its gradient map, and the parameters fitted to it."""
