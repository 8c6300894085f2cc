"""Damiao motors on CAN FD."""
