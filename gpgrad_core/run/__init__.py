"""How work is run: progress and cancelling, results kept, threads and processes, and its end."""
