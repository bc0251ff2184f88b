"""The canvas: cameras that fill it with what is shown, and what is written over it."""
