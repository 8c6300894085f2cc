"""A robot that stays while controllers of other programs come, go and hand over: server, client, verbs."""
