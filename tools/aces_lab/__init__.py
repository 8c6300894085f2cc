"""The lab: what the core does not need, one room each, on public names and seams; a room is deleted in one commit."""
