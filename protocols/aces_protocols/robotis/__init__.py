"""Dynamixel protocol 1.0 (Robotis RX, AX and MX servos)."""
