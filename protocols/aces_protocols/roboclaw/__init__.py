"""Basicmicro RoboClaw motor controllers."""
