"""Dynamixel protocol 2.0 (Robotis X series)."""
