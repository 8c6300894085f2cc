"""MyActuator RMD-X motors (also RMD-L, RMD-H): CAN, protocol V3 and V4."""
