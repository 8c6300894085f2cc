"""The actions of `aces spec`, one a file; see `aces_tools.spec`."""
