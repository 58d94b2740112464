"""Telling a running simulator what shall happen: from its terminal, or from another one.

Must not live here: what can be told (simulator/control.py).
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import click

from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.simulator import ControlError, tell

__all__ = ["control_path", "listen_to_terminal", "tell_simulator"]


def control_path(pty: Path | None, control: Path | None) -> Path | None:
    """Where a simulator is told: as given, or beside its link; None where there is neither."""
    if control is not None:
        return control
    return pty.with_name(pty.name + ".control") if pty is not None else None


def tell_simulator(path: Path | None, lines: tuple[str, ...], *, as_json: bool) -> None:
    """Tell a running simulator lines, one after another, and print what it answers.

    As JSON it is printed when all of them are done, or when one is wrong.

    Raises:
        CommandError: It is not there, or says that a line is wrong.
    """
    if path is None:
        remedy = "give the --pty or the --control that the simulator was started with"
        raise CommandError(Exit.USAGE, Problem("--tell does not know whom to tell", remedy))
    told: list[dict[str, str]] = []
    try:
        for line in lines:
            answer = _tell(path, line)
            told.append({"told": line, "answer": answer})
            if answer and not as_json:
                click.echo(answer)
    finally:
        if as_json:
            click.echo(json.dumps(told, ensure_ascii=False))


def _tell(path: Path, line: str) -> str:
    """Tell one line and give the answer.

    Raises:
        CommandError: The simulator is not there, or says that the line is wrong.
    """
    try:
        return tell(path, line)
    except ControlError as exc:
        raise CommandError(Exit.FAILED, Problem(str(exc))) from exc
    except OSError as exc:
        problem = f"no simulator is told through {path}: {exc.strerror or exc}"
        remedy = "start it with `lecombus simulate`, and name its --pty or --control here"
        raise CommandError(Exit.UNREACHABLE, Problem(problem, remedy)) from exc


def listen_to_terminal(do: Callable[[str], str]) -> bool:
    """Do lines typed into the terminal, if this process is in front of one.

    Args:
        do: Does a line, see `Control.do`.

    Returns:
        Whether there is such a terminal.
    """
    if not sys.stdin.isatty() or os.tcgetpgrp(sys.stdin.fileno()) != os.getpgrp():
        return False
    # Sent to the background later, reading fails instead of stopping the whole simulator.
    signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    threading.Thread(target=_read_lines, args=(do,), name="sim-terminal", daemon=True).start()
    return True


def _read_lines(do: Callable[[str], str]) -> None:
    try:
        for line in sys.stdin:
            try:
                answer = do(line)
            except ControlError as exc:
                answer = f"lecombus: {exc}"
            if answer:
                click.echo(answer, err=True)
    except OSError:
        return
