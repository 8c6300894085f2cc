"""The studio: a page on this machine to look at a bus and to draw a protocol, `aces studio`. Needs the extra `[studio]`."""
