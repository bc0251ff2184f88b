"""What one session holds and does: its state, its workers, its decisions, its file."""
