"""One LECOM exchange after the other: the loop, the jobs it runs, and answers that come late.

A late answer (one that comes after its time-out): `late_replies` knows which ones may still come
and blocks the requests that they could seem to answer; `idle_receive` takes one that comes between
two exchanges, `protocol.exchange` one that comes during another.
"""
