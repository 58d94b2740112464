"""One LECOM exchange after the other: the loop, the jobs it runs, and answers that come late.

A *late answer* is one that comes after its time-out, when its exchange was given up: `late_answers`
knows which ones may still come; `prepared_telegrams` holds the requests back that they could seem
to answer, or asks in the other addressing form; `idle_receive` takes one that comes between two
exchanges, `protocol.exchange` one that comes during another: it is counted and does not end that
exchange's wait. A *second answer* is a copy, or another drive's: nothing is missing. An answer is
*missing* when its exchange ended without it, and a read value is *stale* when it is too old to act
on: that is a word of the store, not of the line.
"""
