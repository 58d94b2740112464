"""Ways to a line beside HTTP: each a process of its own, and a client of the daemon.

A bridge reads from the daemon what it publishes (`line_follower`) and sends what its users ask for
as HTTP requests, so the same rules apply to both. The daemon imports nothing from here, and a
bridge that ends does not disturb the line.
"""
