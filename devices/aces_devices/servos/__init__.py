"""What drivers and twins of servos have in common that are tables of registers on a shared line; no driver of its own."""
