"""Pure LECOM-A/B: characters, code fields, telegrams, parsers and telegram times.

Bytes and numbers only: no clock, no port, no task, no log. Read `telegrams` first (what is said),
then `parser` (how it is read back).
"""
