"""`lecombus simulate`: simulated drives for a roster, and commands to a running simulator."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import click

from lecombus.cli.arguments import json_option
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.config import Roster, load_roster
from lecombus.fieldbus.lecom.simulator import (
    LONGEST_PATH,
    Control,
    ControlError,
    ControlSocket,
    PtyEnd,
    SimLine,
    TcpEnd,
    build,
    parse_faults,
    send_to_simulator,
)

__all__ = ["simulate_command"]

_ENDS = {signal.SIGINT, signal.SIGTERM}


@click.command("simulate")
@click.option("-c", "--config", "roster", metavar="ROSTER",
              type=click.Path(dir_okay=False, path_type=Path),
              help="The roster: a YAML file that describes the line.")  # fmt: skip
@click.option("--pty", type=click.Path(path_type=Path), metavar="PATH",
              help="Serve a pseudo terminal; PATH becomes a link to it.")  # fmt: skip
@click.option("--tcp", metavar="[127.0.0.1:]PORT", help="Serve a TCP port; 0: any free one.")
@click.option("--faults", default="", metavar="FAULTS",
              help="What goes wrong, such as late=0.05:0.5s,noise=0.05,absent=11+12.")  # fmt: skip
@click.option("--control-word", default="state", show_default=True,
              type=click.Choice(["state", "written", "changes"]),
              help="C0135 reads with every inhibit in it, or as it was last written; changes: the "
              "same, and only a change of bit 3 lifts a quick stop.")  # fmt: skip
@click.option("--fault-digit", default="lecom", show_default=True,
              type=click.Choice(["lecom", "p500", "none"]),
              help="C0068 of an SMVector: tens digit of which fault number.")  # fmt: skip
@click.option("--seed", type=int, default=0, help="Seed of the random numbers.")
@click.option("--control", type=click.Path(path_type=Path), metavar="PATH",
              help="A socket for --tell; default: PATH.control of --pty.")  # fmt: skip
@click.option("--tell", "lines", multiple=True, metavar="LINE",
              help="Send a command to a running simulator, such as help, and end.")  # fmt: skip
@json_option
def simulate_command(
    roster: Path | None, pty: Path | None, tcp: str | None, faults: str, seed: int,
    control: Path | None, lines: tuple[str, ...], as_json: bool, control_word: str,
    fault_digit: str,
) -> int:  # fmt: skip
    """Serve the roster's drives as simulated ones until Ctrl-C or SIGTERM.

    Characters take their time at the roster's baud rate, and drives take the answer times of
    the manuals. Point `port:` of the roster that `lecombus run` reads at what is printed here.

    FAULTS are NAME=CHANCE with commas between, chance per telegram from 0 to 1: lost, unheard,
    request-noise, damaged (the drive notices and says so), late (:TIME), double (:TIME; an answer
    comes twice), noise, bad-bcc, parity, half, endless, nak, power-cycle (:TIME), bad-echo; and
    echo, unplugged, nak-reads (NAK to a read that cannot be carried out, as some devices do),
    eot-drops-writes (a drive takes a write at the end of its processing time, or not at all if a
    new telegram begins before that; else it takes a write when it has heard it),
    absent=ADDRESS+ADDRESS, twins=ADDRESS (two drives have it), trip=ADDRESS:NUMBER[:stays]: that
    drive has this fault from the start, and with `stays` no reset helps.

    While it runs, faults and other commands are typed into its terminal, or sent from another
    one: lecombus simulate --pty PATH --tell "trip feeder 50"; help lists them.

    In a pipe the first line is the port and nothing else. With --json: {"port", "line", "baud",
    "drives": [{"drive", "address", "family"}]}; with --tell [{"told", "answer"}], one a LINE.
    """
    where = _control_path(pty, control)
    if lines:
        _tell_simulator(where, lines, as_json=as_json)
        return Exit.DONE
    _check_ends(roster, pty, tcp)
    assert roster is not None
    wanted = load_roster(roster)
    line = _build(wanted, faults, seed, control_word=control_word, digit_of=fault_digit)
    # Blocked before the line's thread starts, so that only sigwait gets them.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDS)
    try:
        with ExitStack() as stack:
            end: PtyEnd | TcpEnd
            if pty is not None:
                end = stack.enter_context(PtyEnd(line, _free_link(pty)))
            else:
                end = stack.enter_context(TcpEnd(line, _tcp_port(tcp or "0")))
            commands = Control(line, end.lock, end)
            if where is not None:
                _serve_control(stack, where, commands, wanted=control is not None)
            typed = _listen_to_terminal(commands.do)
            port = end.path if isinstance(end, PtyEnd) else end.url
            _announce(wanted, port, typed=typed, as_json=as_json)
            signal.sigwait(_ENDS)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return Exit.DONE


def _check_ends(roster: Path | None, pty: Path | None, tcp: str | None) -> None:
    if roster is None:
        raise CommandError(Exit.USAGE, "-c ROSTER is missing", "say which drives to simulate")
    if pty is not None and tcp is not None:
        raise CommandError(Exit.USAGE, "--pty and --tcp are both given", "leave one of them out")
    if pty is None and tcp is None:
        raise CommandError(
            Exit.USAGE, "either --pty or --tcp is needed", "say where to serve the line"
        )


def _serve_control(stack: ExitStack, path: Path, commands: Control, *, wanted: bool) -> None:
    """Serve the control socket; without `--control` a failure is only a message."""
    try:
        if len(os.fsencode(path)) > LONGEST_PATH:
            raise OSError(0, f"a socket's path has at most {LONGEST_PATH} characters")
        stack.enter_context(ControlSocket(path, commands.do))
    except OSError as exc:
        problem = Problem(f"{path} cannot be a control socket: {exc.strerror}",
                          "name a shorter or free path with --control")  # fmt: skip
        if wanted:
            raise CommandError.of(Exit.USAGE, problem) from exc
        click.echo(f"lecombus: {problem}", err=True)


def _build(roster: Roster, faults: str, seed: int, *, control_word: str, digit_of: str) -> SimLine:
    drives = [(entry.name, entry.address, entry.family) for entry in roster.drives]
    parity = roster.line.parity == "line"
    try:
        wanted = parse_faults(faults)
        _check_absent(wanted.absent, roster)
        return build(
            drives, baud=roster.line.baud, faults=wanted, seed=seed, parity=parity,
            word_as_written=control_word == "written", only_changes=control_word == "changes",
            digit_of=digit_of,
        )  # fmt: skip
    except ValueError as exc:
        raise CommandError(Exit.USAGE, str(exc)) from exc


def _check_absent(absent: set[int], roster: Roster) -> None:
    """Refuse addresses under `absent` that the roster does not have: they are mistakes."""
    there = {entry.address for entry in roster.drives}
    if unknown := absent - there:
        problem = f"no drive of {roster.line.name} has the address {min(unknown)}"
        remedy = f"absent takes addresses of the roster: {'+'.join(map(str, sorted(there)))}"
        raise CommandError(Exit.USAGE, problem, remedy)


def _free_link(path: Path) -> Path:
    """Return a path that may become a link: free, or a link that leads nowhere any more.

    A pseudo terminal is gone with the process that made it, so one that is there is alive.
    """
    if path.is_symlink() and path.exists():
        problem = f"{path} leads to {path.readlink()}: a simulator still serves it, or it is a port"
        remedy = "end that one first, or name another path; if it is neither, remove the link"
        raise CommandError(Exit.USAGE, problem, remedy)
    if path.exists() and not path.is_symlink():
        problem = f"{path} exists and is not a link"
        raise CommandError(Exit.USAGE, problem, "name a path that is free")
    return path


def _tcp_port(text: str) -> int:
    host, _, port = text.rpartition(":")
    if host not in ("", "127.0.0.1", "localhost") or not port.isdecimal() or int(port) > 65535:
        remedy = "write --tcp 127.0.0.1:PORT; simulated drives are served to this machine only"
        raise CommandError(Exit.USAGE, f"`{text}` cannot be served", remedy)
    return int(port)


def _announce(roster: Roster, port: str, *, typed: bool, as_json: bool) -> None:
    if as_json:
        drives = [
            {"drive": entry.name, "address": entry.address, "family": entry.family}
            for entry in roster.drives
        ]
        document = {"port": port, "line": roster.line.name, "baud": roster.line.baud}
        click.echo(json.dumps({**document, "drives": drives}))
        return
    click.echo(port)
    count = len(roster.drives)
    what = "1 simulated drive" if count == 1 else f"{count} simulated drives"
    text = f"{what} of {roster.line.name} at {roster.line.baud} baud; Ctrl-C ends this"
    more = "\nType help for what can happen to them, such as trip, unplug, swap." if typed else ""
    click.echo(text + more, err=True)


def _control_path(pty: Path | None, control: Path | None) -> Path | None:
    """Return the control socket: as given, or beside the link; None where there is neither."""
    if control is not None:
        return control
    return pty.with_name(pty.name + ".control") if pty is not None else None


def _tell_simulator(path: Path | None, lines: tuple[str, ...], *, as_json: bool) -> None:
    """Send lines to a running simulator, one after another, and print its answers.

    As JSON they are printed when all lines are done, or when one is wrong and others are done.

    Raises:
        CommandError: It is not there, or says that a line is wrong.
    """
    if path is None:
        remedy = "give the --pty or the --control that the simulator was started with"
        raise CommandError(Exit.USAGE, "--tell needs the simulator that gets the command", remedy)
    sent: list[dict[str, str]] = []
    try:
        for line in lines:
            answer = _send_line(path, line)
            sent.append({"told": line, "answer": answer})
            if answer and not as_json:
                click.echo(answer)
    finally:
        if as_json and sent:
            click.echo(json.dumps(sent, ensure_ascii=False))


def _send_line(path: Path, line: str) -> str:
    """Send one line and return the answer.

    Raises:
        CommandError: The simulator is not there, or says that the line is wrong.
    """
    try:
        return send_to_simulator(path, line)
    except ControlError as exc:
        raise CommandError(Exit.FAILED, str(exc)) from exc
    except OSError as exc:
        problem = f"no simulator answers at {path}: {exc.strerror or exc}"
        remedy = "start it with `lecombus simulate`, and name its --pty or --control here"
        raise CommandError(Exit.UNREACHABLE, problem, remedy) from exc


def _listen_to_terminal(do: Callable[[str], str]) -> bool:
    """Do lines typed into the terminal, if this process is in front of one.

    Args:
        do: Carries out a line and returns the answer.

    Returns:
        Whether there is such a terminal.
    """
    if not sys.stdin.isatty() or os.tcgetpgrp(sys.stdin.fileno()) != os.getpgrp():
        return False
    # Sent to the background later, reading fails instead of stopping the whole simulator.
    signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    threading.Thread(target=_do_typed_lines, args=(do,), name="sim-terminal", daemon=True).start()
    return True


def _do_typed_lines(do: Callable[[str], str]) -> None:
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
