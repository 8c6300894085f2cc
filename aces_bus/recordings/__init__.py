"""Recordings: frames and bytes out of files, pipes and standard input.

1. What a file is, its content says, never its suffix.
2. Every line and byte is accounted for: given, or counted with the reason. Only a source that is not a capture raises.
3. Nothing here knows a protocol, and memory does not grow with the file.
"""
