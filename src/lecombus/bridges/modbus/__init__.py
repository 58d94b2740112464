"""The Modbus TCP bridge: a line of drives as registers, for a PLC.

`register_map` says which register is where, and generates the table of docs/modbus.md.
`register_values` is what they read: what is known of the drives, or a Modbus exception.
`drive_control` is what writing them does: leases, setpoints, commands, stops. `modbus_server`
speaks Modbus with clients; `bridge` puts it together.
"""
