"""Inspect: the values of a place, the associations one by one, the pair from above."""
