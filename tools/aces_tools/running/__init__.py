"""What `aces run` is made of.

loading   controllers out of Python files and trajectories, logs out of --log
figures   what is going on in a run, as numbers: pure
panel     figures as lines of text, for a terminal or a pipe
session   a run from opening to summary
"""
