"""The parts of `aces fuzz`: the work of one process, corpora, and what is printed."""
