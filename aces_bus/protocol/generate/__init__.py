"""From a plan to source text, from text to functions."""
