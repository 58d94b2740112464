"""Supervision: looking after the drives whether or not anybody asks.

`keeper` has the drives audited and their watchdogs fed, `audit` is what they are asked: `gates`
whether they may be written to, `watchdogs` what theirs are set to. `health` judges from every
exchange how each drive is doing, `books` tells everyone concerned what happened on the line.
"""
