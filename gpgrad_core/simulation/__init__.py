"""Datasets with known truth: terrain, a rover that drives over it, and its scans."""
