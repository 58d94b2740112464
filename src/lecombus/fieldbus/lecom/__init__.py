"""LECOM-A/B: its telegrams, its exchanges on the line, its scan, its simulated drives.

No other room but those that put a line or a command together imports from here
(`pyproject.toml` names them).
"""
