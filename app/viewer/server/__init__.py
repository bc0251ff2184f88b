"""Access: who may come in, what they may say, and how much of it."""
