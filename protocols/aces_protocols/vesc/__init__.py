"""VESC motor controllers on CAN."""
