"""Triage: the pairs worth a person's look, one after the other, and what is decided about them."""
