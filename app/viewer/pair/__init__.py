"""The pair: two submaps as surfaces, what joins them, and the verdict."""
