"""Where submaps lie on a larger elevation model, and the record of it."""
