"""Damiao motors on CAN: the MIT frame and its relatives, registers."""
