"""Pololu qik dual motor drivers, several on one serial line."""
