"""From a spec to a plan, from a plan to text, from text to functions."""
