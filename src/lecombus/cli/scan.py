"""`lecombus scan`: what is on a line, and a roster for it."""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from lecombus.cli import client
from lecombus.cli.arguments import daemon_options
from lecombus.cli.client import Daemon, connect
from lecombus.cli.exits import CommandError, Exit, Problem
from lecombus.cli.scan_lines import scan_by_daemon, scan_own_port
from lecombus.cli.scan_progress import ScanProgress
from lecombus.cli.screen import on_terminal, show_rows
from lecombus.config import LineEntry, line_timing
from lecombus.config.building import STATE_DIR
from lecombus.drives import family, read_cost
from lecombus.line.loop import run
from lecombus.line.unheard import END_IT, others_at, shared
from lecombus.protocol import BAUDS, Code, Form, is_drive_address
from lecombus.scanning import (
    Finding,
    ProposedLine,
    Scan,
    ScanPlan,
    check_place,
    entries,
    propose,
    why_nothing,
)

__all__ = ["command"]

ALL_BAUDS = (9600, 19200, 4800, 2400, 1200)
"""Ex works first, then the one people change to."""


@dataclass(frozen=True, slots=True)
class Wish:
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
            raise click.BadParameter(f"`{part}` is no address: write 11, 1-39 or 1-9,11-19")
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
@click.option("--port", metavar="DEVICE", help="Scan on this port; no daemon.")
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
def command(
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
    socket: str | None,
    url: str | None,
    as_json: bool,
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
    wish = Wish(addresses, rates, thorough, output, force, as_json)
    _check_output(wish)
    if all_bauds and bauds:
        raise CommandError(
            Exit.USAGE, Problem("--bauds and --all-bauds are both given", "leave one of them out")
        )
    if port is None:
        if all_bauds or bauds:
            what = "a daemon scans at its line's baud rate only"
            remedy = "leave the rates out, or stop the daemon and scan with --port"
            raise CommandError(Exit.USAGE, Problem(what, remedy))
        return _through_daemon(wish, socket, url)
    if socket or url:
        raise CommandError(
            Exit.USAGE, Problem("--port and a daemon are both given", "leave one of them out")
        )
    line = LineEntry(name=name, port=port, parity=parity, direction=direction)  # type: ignore[arg-type]
    return _on_own_port(wish, line)


def _on_own_port(wish: Wish, line: LineEntry) -> int:
    place = ProposedLine(
        line.name, line.port, line.parity, line.direction, _socket(line.name),
        _state(line.name, wish.output),
    )  # fmt: skip
    check_place(place)
    scan = Scan(ScanPlan(wish.addresses, wish.bauds, wish.thorough))
    with ScanProgress(scan, _look_s(line, wish.bauds[0])) as progress:
        bytes_heard = run(scan_own_port, scan, line, progress.watch)
    others = others_at(line.port)
    if others and scan.found:
        click.echo(f"{shared(line.port, others)}: {END_IT}, and scan again", err=True)
    if not scan.found:
        if others:
            what = f"no drive answers: {shared(line.port, others)}"
            raise CommandError(Exit.FAILED, Problem(what, END_IT, "no-drive"))
        echo = bytes_heard > 0 and not scan.samples  # all that was heard is what was sent
        what, remedy = why_nothing(
            scan.samples, scan.unclear, echo=echo, parity=line.parity,
            bauds=wish.bauds,
        )  # fmt: skip
        raise CommandError(Exit.FAILED, Problem(what, remedy, "no-drive"))
    baud = _commonest(scan.found)
    text, _ = propose(place, baud, scan.found, scan.unclear)
    _give(wish, scan, text, {"port": line.port, "baud": baud})
    return Exit.DONE


def _through_daemon(wish: Wish, socket: str | None, url: str | None) -> int:
    with connect(socket, url) as daemon:
        line = _line_of(daemon)
        known = {int(one["address"]) for one in daemon.get("/v1/drives").data["drives"]}
        addresses = tuple(one for one in wish.addresses if one not in known)
        if not addresses:
            raise CommandError(
                Exit.USAGE, Problem("the roster has all of these addresses", "name others")
            )
        baud = line.baud
        scan = Scan(ScanPlan(addresses, (baud,), wish.thorough, listen_s=0.0))
        with ScanProgress(scan, _look_s(line, baud)) as progress:
            scan_by_daemon(scan, daemon, progress.watch)
        silence = daemon.get("/v1/line").data.get("remarks", {}).get("silence")
    if not scan.found:
        what = f"no drive answers at an address that the roster does not have, at {baud} baud"
        if scan.unclear:
            what, _ = why_nothing(
                scan.samples, scan.unclear, echo=None, parity="line", bauds=(baud,)
            )
        what = "; ".join(filter(None, (what, silence)))
        raise CommandError(Exit.FAILED, Problem(what, "", "no-drive"))
    here = {"port": line.port, "baud": baud}
    added = "\n".join(
        ["# To be added under `drives:` of the roster:", *entries(scan.found, {}), ""]
    )
    _give(wish, scan, added, here)
    return Exit.DONE


def _line_of(daemon: Daemon) -> LineEntry:
    """Ask the daemon what line it has."""
    line = daemon.get("/v1/line").data
    if "port" not in line or "baud" not in line:
        problem = f"the daemon at {daemon.where} does not know scans"
        raise CommandError(Exit.UNREACHABLE, Problem(problem, "update it, or scan with --port"))
    return LineEntry(name="line", port=str(line["port"]), baud=int(line["baud"]))


def _look_s(line: LineEntry, baud: int) -> float:
    """Return how long an address takes at which nothing answers, seconds."""
    timing = line_timing(line.model_copy(update={"baud": baud}))
    cost = read_cost(timing, family("generic"), Code(46), Form.STANDARD)
    return cost.first_byte_s + timing.quarantine_s + timing.turnaround_s


def _commonest(found: list[Finding]) -> int:
    """Return the baud rate at which most drives were found; the first of several."""
    rates = [one.baud for one in found]
    return max(dict.fromkeys(rates), key=rates.count)


def _socket(name: str) -> str:
    """Return a socket for a machine on which nobody has made lecombus' own folder."""
    if client.RUNTIME_DIR.is_dir():
        return ""
    return str(Path(tempfile.gettempdir()) / f"{name}.sock")


def _state(name: str, roster: Path | None) -> str:
    """Return a state file, beside the roster, where nobody has made the folder of such files."""
    if os.access(STATE_DIR, os.W_OK | os.X_OK):
        return ""
    folder = roster.parent if roster is not None else Path()
    return str(folder.resolve() / f"{name}.state.json")


# ---- what comes of it ---------------------------------------------------------------------------


def _check_output(wish: Wish) -> None:
    """Say before a scan, and not after it, that its result cannot be kept."""
    if wish.output is None:
        return
    if wish.output.exists() and not wish.force:
        problem = f"{wish.output} exists"
        raise CommandError(
            Exit.USAGE, Problem(problem, "name another file, or overwrite it with --force")
        )
    if not wish.output.parent.is_dir():
        raise CommandError(
            Exit.USAGE, Problem(f"{wish.output.parent} is no directory", "make it first")
        )
    if not os.access(wish.output.parent, os.W_OK):
        raise CommandError(
            Exit.FORBIDDEN, Problem(f"{wish.output.parent} may not be written to", "name another")
        )


def _give(wish: Wish, scan: Scan, text: str, line: dict[str, Any]) -> None:
    """Show what was found, and give the roster to whom it was wanted for."""
    if wish.output is not None:
        with wish.output.open("w" if wish.force else "x", encoding="utf-8") as file:
            file.write(text)
    if wish.as_json:
        document = {
            **line,
            "drives": [_as_json(one) for one in scan.found],
            "unclear": [{"address": one.address, "baud": one.baud} for one in scan.unclear],
            "roster": text,
        }
        click.echo(json.dumps(document, ensure_ascii=False))
        return
    if wish.output is None:
        click.echo(text, nl=False)
        return
    rows = [
        (str(one.address), str(one.baud), one.family, _software(one), "; ".join(one.remarks))
        for one in sorted(scan.found, key=lambda one: one.address)
    ]
    show_rows(("address", "baud", "family", "says", "note"), rows)
    if on_terminal():
        click.echo(
            f"{wish.output} is written: read it through, then lecombus check -c {wish.output}"
        )


def _software(one: Finding) -> str:
    return ", ".join(f"{code} {text}" for code, text in one.labels)


def _as_json(one: Finding) -> dict[str, Any]:
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
