"""Supervision: looking after the drives whether or not anybody asks.

`keeper` has the drives audited and their watchdogs fed, `audit` is what they are asked, `health`
judges from every exchange how each drive is doing, `books` tells everyone concerned what happened
on the line.
"""
