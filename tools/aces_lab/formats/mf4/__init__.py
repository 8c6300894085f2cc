"""ASAM MDF 4: our own reader of bus logging, and asammdf in a process of its own for what is unusual."""
