"""Bodies of real robots, as chains."""
