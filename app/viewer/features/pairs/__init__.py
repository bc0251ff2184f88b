"""Pairs: all of them as a matrix, as scores and as lists, what is decided, and the pose graph."""
