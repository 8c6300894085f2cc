"""RobStride motors, MIT protocol."""
