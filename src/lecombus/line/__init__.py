"""The line: everything that touches the bus.

Read `worker` first: one exchange at a time, for as long as the daemon lives. `port` is the seam to
what carries the bytes, with `serial_port` and `tcp_port` behind it and `opening` choosing between
them; `jobs` says what is said to get a request done, `prepared_telegrams` puts it into telegrams,
`late_replies` knows which late answers may still come, `port_connection` opens and reopens. `loop`
is the event loop whose timers are accurate enough for a turnaround.
"""
