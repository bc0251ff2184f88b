"""The controls: widgets that report whole new values, and read-outs; they never compute."""
