"""Supervision: looking after the drives whether or not anybody asks.

`drive_supervisor` has the drives audited and their watchdogs fed, `audit` is what they are asked:
`write_prechecks` whether they may be written to, `watchdogs` what theirs are set to. `health`
judges from every exchange how each drive is doing. `exchange_recorder` makes an event of each
exchange for all that follow the line, `line_watch` looks once a second at what they add up to;
`drive_changes` adds, changes and removes drives.
"""
