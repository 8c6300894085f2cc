"""Vector's BLF."""
