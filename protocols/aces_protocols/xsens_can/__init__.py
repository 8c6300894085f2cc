"""Xsens MTi 600 and its like on CAN: what an IMU or AHRS measures."""
