"""The line: everything that uses the bus.

Start with `worker`: it owns the port and runs one exchange at a time (`exchange_loop`). `port` is
the interface to what carries the bytes; `serial_port` and `tcp_port` implement it, `opening`
chooses one, `port_connection` opens and reopens it. `jobs` and `stop_job` give the steps of a
request and `prepared_telegrams` makes their telegrams. `late_replies` knows which late
answers may still come, `prepared_telegrams` asks it before each telegram, and `unsolicited_bytes`
receives them.
`loop` is the event loop, with timers accurate enough for a turnaround.

What must not live here: the order of requests (`schedule`), who is stopped (`operations`), what is
known about the drives (`store`). Ports neither interpret telegrams nor reopen themselves.
"""
