"""The best pair: the likeliest pairs are scored, so that a dataset opens on a loop closure."""
