"""Modes: explore, tune, demonstrate; which panels and which scene are to be seen."""
