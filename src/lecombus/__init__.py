"""lecombus: the daemon that owns a LECOM-A/B line of Lenze drives.

Start reading in `daemon.py`, which builds everything; the rooms and who may import whom stand in
`docs/architecture.md`.
"""

__version__ = "0.1.0"
