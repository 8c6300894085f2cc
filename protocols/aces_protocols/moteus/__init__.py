"""mjbots moteus: brushless servo controllers with a register protocol on CAN FD."""
