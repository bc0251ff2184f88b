"""Nudge: move the query by hand, and refine the motion by the ground."""
