"""Submaps that arrive while a robot drives: where they come from, and how none of them is lost."""
