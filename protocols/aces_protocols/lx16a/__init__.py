"""Hiwonder's LX-16A bus servos (LewanSoul before), and others of the same packets."""
