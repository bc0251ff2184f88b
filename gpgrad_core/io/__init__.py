"""Files in and out: clouds, datasets, poses, coordinates, and records for other programs."""
