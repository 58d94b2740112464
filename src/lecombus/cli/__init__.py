"""The command line. A command is a function NAME_command; related commands share a module.

`entry` finds the command by name and turns errors into lines on standard error and an exit status
(`exits`). Commands on a roster call `config`, the simulator or
`daemon`. Commands to a running daemon
use its HTTP API through `client`. Output goes through `screen`: tables on a terminal, tab-separated
text in a pipe, the daemon's documents with `--json`.

A command's module is imported only when the command is called, and imports heavy libraries only
where it needs them: `lecombus run` must send its first telegram within a second.

What must not live here: protocol, scheduling, and rules about drives.
"""

from __future__ import annotations

from lecombus.cli.entry import main

__all__ = ["main"]
