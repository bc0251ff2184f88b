"""The time line: the drive from its first submap to its last, under the canvas."""
