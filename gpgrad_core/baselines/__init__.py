"""What the pipeline is measured against: one rival a file, each a `LoopDetector`."""
