"""The command line: one file a command, and no logic in any of them.

`entry` finds the command and turns every error into a line and an exit status (`exits`). Commands
that work on a roster call `config`, `simulator` or `daemon`; commands that talk to a running
daemon go through `client`, which is HTTP and nothing else. What is printed goes through `screen`:
tables on a terminal, tab-separated text in a pipe, the daemon's own documents with `--json`.

Nothing heavy is imported before the command that needs it: `lecombus run` shall reach its first
telegram within a second.
"""

from __future__ import annotations

from lecombus.cli.entry import main

__all__ = ["main"]
