"""Supervision: looking after the drives whether or not anybody asks.

`keeper` audits and arms the drives' watchdogs and has them fed, `health` judges from every
exchange how each drive is doing, `books` tells everyone concerned what happened on the line.
"""
