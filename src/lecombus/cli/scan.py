"""`lecombus scan`: the drives on a line, and a roster for them."""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from lecombus.cli.arguments import (
    DaemonOptions,
    check_port_options,
    daemon_options,
    whole_path,
)
from lecombus.cli.daemon_access import work
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.scan_access import ThroughDaemon, scan_own_port
from lecombus.cli.scan_progress import ScanProgress, look_s, scan_bar
from lecombus.cli.screen import on_terminal, show_rows
from lecombus.cli.second_answers import SecondAnswers
from lecombus.cli.whole_file import write_whole
from lecombus.client import Line, finding
from lecombus.config import LineEntry, RosterError
from lecombus.config.building import STATE_DIR
from lecombus.fieldbus.lecom.protocol.addressing import is_drive_address
from lecombus.fieldbus.lecom.protocol.controls import BAUDS
from lecombus.fieldbus.lecom.scanning import (
    FoundDrive,
    ProposedLine,
    Scan,
    ScanPlan,
    check_place,
    entries,
    propose,
    why_nothing,
)
from lecombus.line.devices import END_IT, others_at, shared
from lecombus.line.event_loop import run
from lecombus.supervision.line_remarks import SECOND_ANSWERS_REMARK

__all__ = ["scan_command"]

ALL_BAUDS = (9600, 19200, 4800, 2400, 1200)
"""The factory setting first, then the most usual one."""


@dataclass(frozen=True, slots=True)
class ScanOptions:
    """What the command line asks for, besides where.

    Args:
        addresses: Which to ask.
        bauds: Which rates to try.
        thorough: Ask twice, and go through all rates.
        output: Where the roster goes; None: to standard output.
        force: The file may be overwritten.
        as_json: Print one JSON document.
    """

    addresses: tuple[int, ...]
    bauds: tuple[int, ...]
    thorough: bool
    output: Path | None
    force: bool
    as_json: bool


def _addresses(ctx: click.Context, param: click.Parameter, text: str) -> tuple[int, ...]:
    """Read `1-39,55` as the drive addresses in it."""
    found: dict[int, None] = {}
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise click.BadParameter(f"`{part}` is not an address: write 11, 1-39 or 1-9,11-19")
        for number in range(int(first), int(last or first) + 1):
            if number > 99:
                break
            if is_drive_address(number):
                found[number] = None
    if not found:
        raise click.BadParameter("no drive has such an address: it is 1 to 99, not 10, 20 .. 90")
    return tuple(found)


def _bauds(ctx: click.Context, param: click.Parameter, text: str | None) -> tuple[int, ...]:
    """Read `19200,9600`; none if nothing is given."""
    if text is None:
        return ()
    rates = tuple(part.strip() for part in text.split(","))
    wrong = [rate for rate in rates if not rate.isdecimal() or int(rate) not in BAUDS]
    if wrong:
        known = ", ".join(map(str, BAUDS))
        raise click.BadParameter(f"drives know no {wrong[0]!r} baud: {known} are right")
    return tuple(dict.fromkeys(map(int, rates)))


@click.command("scan")
@click.option("--port", metavar="DEVICE", callback=whole_path,
              help="Scan on this port; no daemon.")  # fmt: skip
@click.option("--bauds", metavar="RATE[,RATE..]", callback=_bauds,
              help="Try these baud rates, until drives answer.  [default: 9600]")  # fmt: skip
@click.option("--all-bauds", is_flag=True, help="Try every baud rate until drives answer.")
@click.option("--addresses", default="1-99", show_default=True, callback=_addresses,
              metavar="LIST", help="Addresses to ask, such as 1-39 or 11,12.")  # fmt: skip
@click.option("--thorough", is_flag=True,
              help="Ask silent addresses twice, and go on through all baud rates.")  # fmt: skip
@click.option("--parity", type=click.Choice(["line", "port"]), default="line", show_default=True,
              help="As in a roster: who makes even parity.")  # fmt: skip
@click.option("--direction", type=click.Choice(["adapter", "kernel", "rts"]), default="adapter",
              show_default=True, help="As in a roster: who switches the transceiver.")  # fmt: skip
@click.option("--name", default="line", show_default=True, help="The line's name in the roster.")
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
              help="Write the roster there instead of showing it.")  # fmt: skip
@click.option("--force", is_flag=True, help="Overwrite FILE.")
@daemon_options
@click.pass_context
def scan_command(
    ctx: click.Context,
    port: str | None,
    bauds: tuple[int, ...],
    all_bauds: bool,
    addresses: tuple[int, ...],
    thorough: bool,
    parity: str,
    direction: str,
    name: str,
    output: Path | None,
    force: bool,
    daemon: DaemonOptions,
) -> int:
    """Find the drives on a line, say what they are, and propose a roster.

    With --port the line must be free: a port in use is refused, and so is a line on which
    another master sends. All addresses at one baud rate take about 20 seconds. Without --port a
    running daemon asks those addresses that its roster does not have, at its own baud rate,
    while it does its work; the drives found are to be added to its roster.

    Scan while the machine may stand still: a watchdog that is set in a drive may act after the
    scan, when nothing is sent to the drive any more.

    Nothing is ever written to a drive. A family that cannot be identified for certain is
    proposed as generic, or with a comment. The roster goes to standard output, or with -o to a
    file.

    With --json: {"port", "baud", "drives": [{"drive", "address", "baud", "family", "certain",
    "why", "says", "watchdog", "remarks"}], "unclear", "roster"}. Exit status 1: no drive found.
    """
    rates = ALL_BAUDS if all_bauds else bauds or (9600,)
    options = ScanOptions(addresses, rates, thorough, output, force, daemon.as_json)
    _check_output(options)
    if all_bauds and bauds:
        raise CommandError(
            Exit.USAGE, "--bauds and --all-bauds are both given", "leave one of them out"
        )
    if port is None and (all_bauds or bauds):
        what = "a daemon scans at its line's baud rate only"
        remedy = "leave the rates out, or stop the daemon and scan with --port"
        raise CommandError(Exit.USAGE, what, remedy)
    check_port_options(
        ctx, port, daemon, only_with=("parity", "direction", "name"),
        why="a daemon scans its line",
    )  # fmt: skip
    if port is None:
        return _through_daemon(options, daemon)
    line = LineEntry(name=name, port=port, parity=parity, direction=direction)  # type: ignore[arg-type]
    return _on_own_port(options, line)


def _on_own_port(options: ScanOptions, line: LineEntry) -> int:
    place = ProposedLine(
        line.name, line.port, line.parity, line.direction, _socket(line.name),
        _state(line.name, options.output),
    )  # fmt: skip
    try:
        check_place(place)
    except RosterError as exc:  # its places are those of a roster that the user does not see
        wrong = (Problem(one.what, one.right) for one in exc.mistakes)
        raise CommandError.of(Exit.USAGE, *wrong) from exc
    scan = Scan(ScanPlan(options.addresses, options.bauds, options.thorough))
    second = SecondAnswers()
    with scan_bar() as bar:
        watch = ScanProgress(scan, look_s(line, options.bauds[0]), bar).watch
        bytes_heard = run(scan_own_port, scan, line, watch, second)
    others = others_at(line.port)
    if others and scan.found:
        click.echo(f"{shared(line.port, others)}: {END_IT}, and scan again", err=True)
    elif twice := _remark_shared_addresses(scan, second):
        click.echo(twice, err=True)
    if not scan.found:
        if others:
            what = f"no drive answers: {shared(line.port, others)}"
            raise CommandError(Exit.FAILED, what, END_IT, "no-drive")
        echo = bytes_heard > 0 and not scan.samples  # all that was heard is what was sent
        what, remedy = why_nothing(
            scan.samples, scan.unclear, echo=echo, parity=line.parity,
            bauds=options.bauds,
        )  # fmt: skip
        raise CommandError(Exit.FAILED, what, remedy, "no-drive")
    baud = _commonest(scan.found)
    text, _ = propose(place, baud, scan.found, scan.unclear)
    _give(options, scan, text, {"port": line.port, "baud": baud})
    return Exit.DONE


def _through_daemon(options: ScanOptions, where: DaemonOptions) -> int:
    scan, here, remarks = work(where, lambda line: _scan_of(options, line))
    baud = here.baud
    if twice := remarks.get(SECOND_ANSWERS_REMARK):
        click.echo(twice, err=True)
    if not scan.found:
        what = f"no drive answers at an address that the roster does not have, at {baud} baud"
        if scan.unclear:
            what, _ = why_nothing(
                scan.samples, scan.unclear, echo=None, parity="line", bauds=(baud,)
            )
        what = "; ".join(filter(None, (what, remarks.get("silence"))))
        raise CommandError(Exit.FAILED, what, "", "no-drive")
    added = "\n".join(
        ["# To be added under `drives:` of the roster:", *entries(scan.found, {}), ""]
    )
    _give(options, scan, added, {"port": here.port, "baud": baud})
    return Exit.DONE


async def _scan_of(options: ScanOptions, line: Line) -> tuple[Scan, LineEntry, dict[str, str]]:
    """Scan through the daemon; returns its line too, and the remarks on that."""
    here = await _line_of(line)
    known = {int(one["address"]) for one in (await line.ask("/v1/drives")).data["drives"]}
    addresses = tuple(one for one in options.addresses if one not in known)
    if not addresses:
        raise CommandError(Exit.USAGE, "the roster has all of these addresses", "name others")
    scan = Scan(ScanPlan(addresses, (here.baud,), options.thorough, listen_s=0.0))
    with scan_bar() as bar:
        watch = ScanProgress(scan, look_s(here, here.baud), bar).watch
        try:
            await scan.run(ThroughDaemon(line, watch))
        finally:
            watch()
    return scan, here, (await line.ask("/v1/line")).data.get("remarks", {})


async def _line_of(daemon: Line) -> LineEntry:
    """Ask the daemon what line it has."""
    line = (await daemon.ask("/v1/line")).data
    if "port" not in line or "baud" not in line:
        problem = f"the daemon at {daemon.where} cannot scan"
        raise CommandError(Exit.UNREACHABLE, problem, "update it, or scan with --port")
    return LineEntry(name="line", port=str(line["port"]), baud=int(line["baud"]))


def _commonest(found: list[FoundDrive]) -> int:
    """Return the baud rate at which most drives were found; the first of several."""
    rates = [one.baud for one in found]
    return max(dict.fromkeys(rates), key=rates.count)


def _socket(name: str) -> str:
    """Return a socket in the temporary folder where lecombus' folder does not exist."""
    if finding.RUNTIME_DIR.is_dir():
        return ""
    return str(Path(tempfile.gettempdir()) / f"{name}.sock")


def _state(name: str, roster: Path | None) -> str:
    """Return a state file beside the roster where the folder of state files does not exist."""
    if os.access(STATE_DIR, os.W_OK | os.X_OK):
        return ""
    folder = roster.parent if roster is not None else Path()
    return str(folder.resolve() / f"{name}.state.json")


# ---- the result ---------------------------------------------------------------------------


def _check_output(options: ScanOptions) -> None:
    """Check before a scan that its result can be written.

    Raises:
        CommandError: It cannot.
    """
    if options.output is None:
        return
    if options.output.exists() and not options.force:
        problem = f"{options.output} exists"
        raise CommandError(Exit.USAGE, problem, "name another file, or overwrite it with --force")
    if not options.output.parent.is_dir():
        problem = f"{options.output.parent} is not a directory"
        raise CommandError(Exit.USAGE, problem, "make it first")
    if not os.access(options.output.parent, os.W_OK):
        raise CommandError(
            Exit.FORBIDDEN, f"{options.output.parent} may not be written to", "name another"
        )


def _give(options: ScanOptions, scan: Scan, text: str, line: dict[str, Any]) -> None:
    """Print what was found, and write the roster; one that cannot be written is printed.

    Raises:
        OSError: It could not be written; what was there is as it was.
    """
    failure: OSError | None = None
    if options.output is not None:
        try:
            write_whole(options.output, text, may_replace=options.force)
        except OSError as exc:
            failure = exc
    if options.as_json:
        document = {
            **line,
            "drives": [_as_json(one) for one in scan.found],
            "unclear": [{"address": one.address, "baud": one.baud} for one in scan.unclear],
            "roster": text,
        }
        click.echo(json.dumps(document, ensure_ascii=False))
    elif options.output is None or failure is not None:
        click.echo(text, nl=False)
    else:
        _show_found(scan, options.output)
    if failure is not None:
        raise failure


def _show_found(scan: Scan, output: Path) -> None:
    rows = [
        (str(one.address), str(one.baud), one.family, _software(one), "; ".join(one.remarks))
        for one in sorted(scan.found, key=lambda one: one.address)
    ]
    show_rows(("address", "baud", "family", "says", "note"), rows)
    if on_terminal():
        click.echo(f"{output} is written: read it through, then lecombus check -c {output}")


def _software(one: FoundDrive) -> str:
    return ", ".join(f"{code} {text}" for code, text in one.labels)


def _as_json(one: FoundDrive) -> dict[str, Any]:
    dog = one.watchdog
    return {
        "drive": one.name,
        "address": one.address,
        "baud": one.baud,
        "family": one.family,
        "certain": one.certain,
        "why": one.why,
        "says": {str(code): text for code, text in one.labels},
        "watchdog": None if dog is None else {"time_s": dog.time_s, "action": dog.action},
        "remarks": list(one.remarks),
    }


def _remark_shared_addresses(scan: Scan, second: SecondAnswers) -> str:
    """Remark drives that share an address; returns what is said where that is not clear."""
    texts = second.shared_addresses()
    scan.found[:] = [
        replace(one, remarks=(*one.remarks, text))
        if (text := texts.get((one.address, one.baud)))
        else one
        for one in scan.found
    ]
    return "" if texts else second.unexplained()
