"""From what a robot recorded to submaps: scans and poses in, a dataset out."""
