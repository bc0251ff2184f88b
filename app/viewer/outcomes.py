"""What becomes of a pair: its verdict, and where the truth is known, whether that is right."""

ACCEPTED, REFUSED = "accepted", "refused"
RIGHT, WRONG_MOTION, NO_OVERLAP, MISSED = "right", "wrong motion", "no overlap", "missed"
