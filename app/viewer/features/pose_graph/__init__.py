"""Pose graph: which closures count, and the map that they correct."""
