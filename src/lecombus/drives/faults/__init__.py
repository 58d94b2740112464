"""Faults of the drives: numbers, keypad texts, meanings, causes and remedies, from data files.

`fault_tables` has the tables, `causes` and `reasons` the rules, the `*.yaml` beside them the data
with the manuals' sections.
"""
