"""Scanners for what arrives: CAN frames and byte streams, piece by piece."""
