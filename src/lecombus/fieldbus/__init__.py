"""The seam between a line protocol and all other rooms.

What must not live here: the bytes of a protocol, which are in the room of that protocol
(`fieldbus.lecom`).
"""
