"""SBUS, Futaba's serial protocol from radio-control receivers to servos and flight controllers."""
