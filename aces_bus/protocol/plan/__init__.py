"""A message's layout, worked out once: what every printer, drawing and export reads."""
