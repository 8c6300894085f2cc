"""OBD-II: live values, trouble codes, the vehicle's number."""
