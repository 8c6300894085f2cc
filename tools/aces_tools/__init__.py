"""The `aces` command, one file a verb.

A verb's file is imported only when that verb runs, so that `aces --help` stays quick. What a verb does beyond reading
its arguments and printing belongs to `aces_bus`, where a program can call it too.
"""
