"""The demo: drives of five families, simulated, run by the whole daemon, with a live view.

Nothing is staged beyond the drives: their bytes go through port, worker, schedule, store and HTTP
like those of a cabinet, paced at 9600 baud. The demo enables the drives, gives them setpoints that
change, and shows what the store says once a second: a table on a terminal, plain lines in a pipe.
"""

from __future__ import annotations

import itertools
import socket as sockets
import sys
import tempfile
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import anyio

from lecombus.config import Roster, parse_roster
from lecombus.daemon import Daemon, plain_errors
from lecombus.drive_state.readings import Quality, Reading
from lecombus.errors import LecombusError, OperationError
from lecombus.line.event_loop import run as run_loop
from lecombus.line_runtime import LineRuntime
from lecombus.parameters import Code

if TYPE_CHECKING:
    from rich.console import Group
    from rich.live import Live
    from rich.table import Table

__all__ = ["View", "run_demo"]

ROSTER = """\
line: {{name: demo, port: 'sim:', baud: 9600}}
drives:
  - {{name: feeder, address: 11, family: 8200vector, watchdog: {watchdog}}}
  - {{name: belt, address: 12, family: 821x, watchdog: {watchdog}}}
  - {{name: pump, address: 13, family: 820x, watchdog: {watchdog}}}
  - {{name: winder, address: 21, family: 93xx, watchdog: {watchdog}}}
  - {{name: fan, address: 22, family: smvector, watchdog: {watchdog}}}
groups:
  conveyors: {{members: [feeder, belt, pump]}}
on_shutdown: inhibit
api: {{socket: {socket}, http: '{http}'}}
"""

WATCHDOG = "{time: 3s, action: quick-stop, configure: true}"

CONTROL_WORD = Code(135)
INHIBIT = Code(40)

SETPOINTS: dict[str, tuple[Code, tuple[int, ...]]] = {
    "feeder": (Code(46), (35, 20)),
    "belt": (Code(46), (25, 40)),
    "pump": (Code(46), (45, 30)),
    "winder": (Code(141), (60, 80)),
    "fan": (Code(1061), (30, 15)),
}

USUAL_PORT = 9740

CHANGE_EVERY = 12
"""Rounds of one second between two changes of the setpoints."""


def run_demo(seconds: float | None, http: str | None) -> int:
    """Run the demo until Ctrl-C, or for so many seconds.

    Args:
        seconds: How long; None: until Ctrl-C or SIGTERM.
        http: `HOST:PORT` for the API and `/metrics`, on loopback; port 0: any free one. None:
            `USUAL_PORT`, or any free one where that is in use.

    Returns:
        Exit status 0.

    Raises:
        RosterError: `http` is not a loopback address.
        OperationError: Nothing can listen there.
    """
    said = ""
    if http is None:
        port = free_port(USUAL_PORT)
        if port is None:
            port = free_port(0)
            said = f"port {USUAL_PORT} is in use: HTTP is served on port {port} this time"
        http = f"127.0.0.1:{port}"
    else:
        http = checked(http)
    with tempfile.TemporaryDirectory(prefix="lecombus-demo-") as folder, plain_errors():
        socket = Path(folder) / "demo.sock"
        text = ROSTER.format(watchdog=WATCHDOG, socket=socket, http=http)
        roster = parse_roster(text, "demo.yaml")
        run_loop(_main, roster, seconds, socket, said)
    return 0


def free_port(port: int) -> int | None:
    """Return a port of 127.0.0.1 that can be listened on: the one given, for 0 any; or None."""
    with sockets.socket() as trying:
        trying.setsockopt(sockets.SOL_SOCKET, sockets.SO_REUSEADDR, 1)
        try:
            trying.bind(("127.0.0.1", port))
            trying.listen()
        except OSError:
            return None
        return int(trying.getsockname()[1])


def checked(http: str) -> str:
    """Return what `--http` says with a port that is free, before anything is drawn.

    Raises:
        OperationError: The port is in use. Other mistakes are found with the roster.
    """
    host, _, port = http.rpartition(":")
    if host not in ("127.0.0.1", "localhost") or not port.isdecimal() or int(port) > 65535:
        return http
    found = free_port(int(port))
    if found is None:
        raise OperationError(
            f"cannot listen on {http}: the port is in use, or not for this user",
            kind="cannot-listen",
            remedy="name another one, such as --http 127.0.0.1:0 for any that is free",
        )
    return f"{host}:{found}"


async def _main(roster: Roster, seconds: float | None, socket: Path, said: str) -> None:
    daemon = Daemon(roster, None)
    view = View(sys.stdout, roster, socket)
    if said:
        view.say(said)
    try:
        async with anyio.create_task_group() as tasks:
            tasks.start_soon(_play, daemon, view, seconds)
            await daemon.main()
            tasks.cancel_scope.cancel()
    finally:
        view.leave()  # an error, too, is shown below the table and with the cursor shown
    view.say_ended()


async def _play(daemon: Daemon, view: View, seconds: float | None) -> None:
    """Show the drives every second, and move them as soon as they can be moved."""
    end_at = None if seconds is None else anyio.current_time() + seconds
    enabled: set[str] = set()
    for round_ in itertools.count():
        if daemon.runtime is not None:
            view.show(daemon.runtime)
            await _move(daemon, view, round_, enabled)
        await anyio.sleep(1.0)
        if end_at is not None and anyio.current_time() >= end_at:
            daemon.end()
            return


async def _move(daemon: Daemon, view: View, round_: int, enabled: set[str]) -> None:
    """Enable each drive once it is online, and change the setpoints every few seconds."""
    assert daemon.runtime is not None
    for name, (code, values) in SETPOINTS.items():
        state = daemon.runtime.store.drive(name).state.value
        if state != "online":
            continue
        try:
            if name not in enabled:
                enabled.add(name)
                await daemon.runtime.operations.write(name, CONTROL_WORD, "H0000")
                await daemon.runtime.operations.write(name, INHIBIT, 1)
            elif round_ % CHANGE_EVERY:
                continue
            value = values[(round_ // CHANGE_EVERY) % len(values)]
            await daemon.runtime.operations.write(name, code, Decimal(value), expires_s=5.0)
        except LecombusError as exc:
            view.say(f"{name}: {exc}")


SHOWN = {"frequency": Code(50), "status word": Code(150)}


class View:
    """Shows a runtime again and again.

    Args:
        out: Where to.
        roster: What is shown.
        socket: The API's Unix socket, named in the headline.
    """

    def __init__(self, out: TextIO, roster: Roster, socket: Path) -> None:
        self._out = out
        self._headline = headline(roster, socket)
        self._live: Live | None = None
        self._said = ""
        if out.isatty():
            from rich.console import Console
            from rich.live import Live

            self._live = Live(console=Console(file=out), auto_refresh=False)
            self._live.start()
        else:
            print(self._headline, file=out, flush=True)

    def show(self, runtime: LineRuntime) -> None:
        """Show what is known now."""
        rows = [row(runtime, info.name) for info in runtime.store.drives()]
        counts = f"{runtime.worker.exchanges} exchanges, {runtime.store.line().state.value}"
        if self._live is not None:
            self._live.update(screen(f"{self._headline}\n{counts}", rows, self._said), refresh=True)
            return
        for cells in rows:
            print("  ".join(f"{cell:<12}" for cell in cells).rstrip(), file=self._out)
        print(f"-- {counts}", file=self._out, flush=True)

    def say(self, text: str) -> None:
        """Show something that went wrong."""
        self._said = text
        if self._live is None:
            print(text, file=self._out, flush=True)

    def leave(self) -> None:
        """Give the terminal back, with the last table on it."""
        if self._live is not None:
            self._live.stop()

    def say_ended(self) -> None:
        """Say what was done at the end."""
        print("all drives inhibited, port closed, good-bye", file=self._out, flush=True)


def headline(roster: Roster, socket: Path) -> str:
    """Say where the running demo can be reached."""
    http = roster.api.http
    return (
        f"lecombus demo: {len(roster.drives)} simulated drives at {roster.line.baud} baud; "
        f"Ctrl-C ends it\nmetrics: http://{http}/metrics   values: http://{http}/v1/drives\n"
        f"commands: lecombus status --socket {socket}"
    )


def row(runtime: LineRuntime, name: str) -> list[str]:
    """The cells of one drive."""
    info = runtime.store.drive(name)
    family = runtime.store.family(name)
    readings = [runtime.store.reading(name, code) for code in SHOWN.values()]
    frequency, word = readings
    return [
        name,
        family.name,
        info.state.value,
        cell(frequency),
        cell(word),
        ", ".join(named_bits(runtime, name, word)),
    ]


def cell(reading: Reading | None) -> str:
    """One value with its unit; what is not good is not shown as if it were."""
    if reading is None or reading.value is None:
        return "-"
    text = f"{reading.value.raw} {reading.unit or ''}".strip()
    return text if reading.quality is Quality.GOOD else f"({text}, {reading.quality.value})"


def named_bits(runtime: LineRuntime, name: str, word: Reading | None) -> list[str]:
    """The bits of the status word that are set and have a name."""
    if word is None or word.value is None or not isinstance(word.value.number, int):
        return []
    bits = runtime.store.family(name).status_bits(word.code, word.value.number)
    return [bit.replace("_", " ") for bit, is_set in bits.items() if is_set]


def screen(title: str, rows: list[list[str]], said: str) -> Group:
    """Draw everything; the empty last line is where the terminal writes the `^C` of a Ctrl-C.

    Behind the end of the table it would begin a new line, and the table would be drawn one line
    lower than where it stands.
    """
    from rich.console import Group
    from rich.text import Text

    return Group(table(title, rows, said), Text())


def table(title: str, rows: list[list[str]], said: str) -> Table:
    """Draw the rows for a terminal."""
    from rich.table import Table

    # Without lines, so that five drives fit 80 columns and 24 lines.
    drawn = Table(title=title, caption=said or None, title_justify="left", box=None, pad_edge=False)
    for head in ("drive", "family", "state", *SHOWN, "bits set"):
        drawn.add_column(head)
    for cells in rows:
        drawn.add_row(*cells)
    return drawn
