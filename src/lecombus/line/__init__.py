"""The line: its port, and the worker that owns it.

Start with `worker`: it opens the port and runs the exchange loop of the protocol on it.
`fieldbus.port` is the interface to what carries the bytes; `serial_port` and `tcp_port` implement
it, `opening` chooses one, `port_connection` opens and reopens it.
`event_loop` is the event loop, with timers accurate enough for a turnaround.

What must not live here: the order of requests (`schedule`), who is stopped (`operations`), what is
known about the drives (`drive_state.store`). Ports neither interpret telegrams nor reopen
themselves.
"""
