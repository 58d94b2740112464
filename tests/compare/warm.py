"""Runs many commands of a tree in forks of one process: an interpreter for each takes ten times.

    PYTHONPATH=src python warm.py < LINES > RESULTS

Both are JSON: lists of words; and of exit status, standard output and standard error. `WARMING` is
run first in this process, so that most modules are loaded. Nothing of lecombus is imported by name:
a command is started as `python -m lecombus` does it.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import runpy
import signal
import sys
import tempfile

WARMING = (
    ["check", "-c", "right/good.yaml", "--json"],
    ["plan", "-c", "right/good.yaml", "--json"],
    ["describe", "generic", "--json"],
)
TIME_S = 60
"""A command that takes longer is ended by a signal, which its exit status shows."""


def start(words: list[str]) -> int:
    """Start the program in this process and return its exit status."""
    sys.argv = ["lecombus", *words]
    try:
        runpy.run_module("lecombus", run_name="__main__", alter_sys=True)
    except SystemExit as exc:
        return exc.code if isinstance(exc.code, int) else int(exc.code is not None)
    return 0


def forked(words: list[str]) -> tuple[int, str, str]:
    """Run a command in a fork."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        child = os.fork()
        if child == 0:
            _be_the_command(words, out.fileno(), err.fileno())
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode(errors="backslashreplace"))
    return status, texts[0], texts[1]


def _be_the_command(words: list[str], out: int, err: int) -> None:
    status = 1
    try:
        os.dup2(out, 1)
        os.dup2(err, 2)
        signal.alarm(TIME_S)
        status = start(words)
        sys.stdout.flush()
    except BaseException:  # noqa: BLE001 - shown as the interpreter shows it
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stderr.flush()
        os._exit(status)


def main() -> None:
    lines = json.load(sys.stdin)
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        for words in WARMING:
            start(words)
    json.dump([forked(words) for words in lines], sys.stdout)


if __name__ == "__main__":
    main()
