"""CANopen: what every node of a network speaks."""
