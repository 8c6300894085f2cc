"""All that happens, live, for Foxglove: `--foxglove` of sniff, run, sim and play. Needs the extra `[foxglove]`."""
