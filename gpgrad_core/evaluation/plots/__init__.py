"""Plots of an evaluation's report and the paper's figures, without matplotlib's global state."""
