"""Data: open a dataset from a folder, a path or an upload."""
