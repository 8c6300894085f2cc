"""What `aces plot` is made of: signals by name, series of bounded size, and two ways to draw them.

`select` finds signals by pattern, `series` collects their values out of tables, `picture` lays them out in panels;
`figure` draws those with matplotlib, `terminal` with characters.
"""
