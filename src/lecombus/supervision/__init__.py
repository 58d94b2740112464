"""Supervision: looking after the drives whether or not anybody asks.

`drive_supervisor` audits the drives and has their watchdogs fed: `write_prechecks` asks whether
they may be written to, `watchdogs` what theirs are set to. `health` judges from every exchange how
each drive is doing. `exchange_recorder` makes an event of each exchange for all that follow the
line, `line_watch` looks once a second at what they add up to; `drive_changes` adds, changes and
removes drives.
"""
