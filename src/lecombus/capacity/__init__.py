"""What a line can carry and how long requests wait, calculated from a roster.

* `exchange_costs`: the line time of exchanges.
* `watchdog_demand`: what feeding the watchdogs takes, and whether it fits (by `demand_bound`).
* `watchdog_feasibility`: which watchdogs cannot be held; `config` refuses such rosters.
* `load`: the shares of the line that are used, at other baud rates too, and with drives away.
* `waits`: how long each class of requests waits at most, behind its `work_ahead`.
* `plan`: all of this together; `live` compares it with a running line, whose `facts` it gets.
* `timeline`: the real schedule run over a roster, and a picture of it.

Pure: no clock, no port. Costs come from the model that schedule and time-outs use
(`fieldbus`). What must not live here: reading a roster (`config`), choosing what is sent next
(`schedule`).
"""
