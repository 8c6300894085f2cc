"""Recordings as verbs read them.

pieces      what scanners are fed              totals          where every frame and byte went
selection   what goes on to an output          traffic         frames counted by identifier
where       conditions on fields               fitting         which protocols a recording is of
window      a piece by time                    device_columns  columns that say whose a message is
"""
