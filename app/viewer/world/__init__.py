"""World: all submaps where they lie, with trajectories and loop closures."""
