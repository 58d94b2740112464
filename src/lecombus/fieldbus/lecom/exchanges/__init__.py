"""One LECOM exchange after the other: the loop, the jobs it runs, and answers that come late.

`late_replies` deals with answers that come after their time-out.
"""
