"""Other doors to a line than HTTP: each a process of its own, and a client of the daemon.

A bridge reads what it tells the world from the daemon (`line_follower`) and hands on what the world
wants done as HTTP requests, so that both obey the same rules. Nothing here is imported by the
daemon, and a bridge that dies takes nothing of the line with it.
"""
