"""Gaussian-process regression of terrain: kernel, dense oracle, fast exact inference."""
