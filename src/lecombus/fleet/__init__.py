"""Many lines on one message broker: which of them need attention, and the stop of one.

A client of the broker, not of a daemon: it reads what the MQTT bridges of the lines show there,
two topics a line, and can ask a bridge for a stop. `lines` holds what is known and judges it,
`following` is the connection, `stopping` sends stops and gathers their outcomes.

What must not live here: what one line or drive means (the bridge says that in its summary), and
the terminal (`cli`).
"""
