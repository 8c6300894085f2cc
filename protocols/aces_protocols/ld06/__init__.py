"""LDROBOT's LD06 and its like: laser scanners that send packets of twelve distances."""
