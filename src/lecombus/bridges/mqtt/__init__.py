"""The MQTT bridge: a line on a message broker (docs/mqtt.md).

`topics` names the topics, `retained` says what stands at the broker, `board` when it is sent again,
`commands` turns messages into HTTP requests (`command_bodies`: what they say), `seen_commands`
remembers which came before, `event_queue` keeps events while the broker is away, `discovery` makes
drives known to Home Assistant, `broker` is one connection, and `bridge` puts them together.
"""
