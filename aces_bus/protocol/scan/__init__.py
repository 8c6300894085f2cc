"""Running: scanners for frames and streams, and the slow truth they must equal."""
