"""Motion by hand: a leader arm, a keyboard, a gamepad, or another program that gives set-points; each with a dead-man."""
