"""Badges of protocols: what was run of an entry of the catalogue, or of a file, and passed."""
