"""CyberGear and RobStride motors on CAN: their private protocol."""
