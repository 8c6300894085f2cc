"""ODrive motor controllers on CAN: CAN Simple of the firmwares 0.5 and 0.6."""
