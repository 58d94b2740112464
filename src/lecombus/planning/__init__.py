"""Planning: what a line can hold, said before it runs.

Start reading at `plan`, which puts a plan together from exchanges and their costs, `waits` (how
long each class waits at worst), `watchdogs` (how short each could be) and `loads` (what else the
line could do). `preview` runs the real schedule over the roster, in no time, for `picture`.

Pure: no clock, no line. The numbers come from the one cost model that schedule and time-outs use.
"""
