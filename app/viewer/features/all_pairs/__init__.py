"""All pairs: every pair compared, as a matrix and as a precision-recall curve."""
