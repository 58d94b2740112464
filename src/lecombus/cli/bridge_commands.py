"""`lecombus bridge`: ways to a line beside HTTP, each in a separate process.

Each bridge is imported when it is called; its libraries are extras of the package.
"""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from lecombus.cli.arguments import json_option, roster_option
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.run import FORMATS, LEVELS, set_up_logging

if TYPE_CHECKING:
    from lecombus.roster import Roster

__all__ = ["bridge_command", "extra"]

Function = Callable[..., Any]

MAP_FORMS: Final = ("text", "markdown")


@click.group("bridge")
def bridge_command() -> None:
    """Run a bridge between a line and programs that speak another protocol.

    A bridge is a client of the line's daemon. It obeys the same rules as HTTP, and it may be
    started and ended at any time.
    """


def log_options(command: Function) -> Function:
    """Give a command the options of the log, as `lecombus run` has them."""
    command = click.option(
        "--log-format", type=click.Choice(FORMATS), envvar="LECOMBUS_LOG_FORMAT", default="logfmt",
        show_default=True,
    )(command)  # fmt: skip
    return click.option(
        "--log-level", type=click.Choice(LEVELS, case_sensitive=False),
        envvar="LECOMBUS_LOG_LEVEL", default="info", show_default=True,
    )(command)  # fmt: skip


@bridge_command.command("modbus")
@roster_option
@click.option("--map", "shows_map", is_flag=True,
              help="Print the registers of this roster, and end.")  # fmt: skip
@click.option("--markdown", is_flag=True, help="With --map: the tables of docs/modbus.md.")
@json_option
@log_options
def modbus_command(
    roster: Path,
    shows_map: bool,
    markdown: bool,
    as_json: bool,
    log_level: str,
    log_format: str,
) -> int:
    """Answer Modbus TCP, as the roster's `modbus:` says, until SIGTERM or Ctrl-C.

    Values that are not fresh are answered with an exception. Writing needs `control: true`, and a
    heartbeat that counts up: docs/modbus.md. Modbus has no passwords: the roster's `allow` lists
    who may connect.

    With --map, in a pipe: one line a register (register, words, drive, name, part, code, scale,
    meaning).
    """
    from lecombus.config import load_roster

    line = load_roster(roster)
    if shows_map:
        show_map(line, as_json=as_json, markdown=markdown)
        return Exit.DONE
    entry = line.modbus
    if entry is None:
        raise CommandError(
            Exit.USAGE, f"{roster} has no key `modbus`", "write `modbus: {}` into it"
        )
    bridge = extra("lecombus.bridges.modbus.bridge", "modbus", "pymodbus")
    set_up_logging(log_level, log_format)
    try:
        return run_until_signal("lecombus-modbus", partial(bridge.run_bridge, line, entry))
    except OSError as exc:
        problem = f"{entry.host}:{entry.port} cannot be listened on: {exc.strerror or exc}"
        raise CommandError(
            Exit.FORBIDDEN if isinstance(exc, PermissionError) else Exit.FAILED, problem,
            "name another `host` or `port` under `modbus`; ports below 1024 need "
            "CAP_NET_BIND_SERVICE, as deploy/lecombus-modbus@.service gives it",
        ) from exc  # fmt: skip


@bridge_command.command("mqtt")
@roster_option
@click.option(
    "--state",
    "directory",
    type=click.Path(file_okay=False, path_type=Path),
    envvar="STATE_DIRECTORY",
    help="Where events that wait for the broker, and the keys of commands, are kept; default: "
    "nowhere.",
)
@log_options
def mqtt_command(roster: Path, directory: Path | None, log_level: str, log_format: str) -> int:
    """Show the line on an MQTT broker, as the roster's `mqtt:` says, until SIGTERM or Ctrl-C.

    Values stand at the broker for as long as they are fresh. Stops are carried out; other commands
    need `control: true`: docs/mqtt.md.
    """
    from lecombus.config import load_roster

    line = load_roster(roster)
    if line.mqtt is None:
        remedy = "write the broker into it, such as `mqtt: {host: broker.example}`"
        raise CommandError(Exit.USAGE, f"{roster} has no key `mqtt`", remedy)
    bridge = extra("lecombus.bridges.mqtt.bridge", "mqtt", "aiomqtt", "paho")
    set_up_logging(log_level, log_format)
    if directory is not None:
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)

    async def work() -> None:
        await bridge.MqttBridge(line, directory).run()

    return run_until_signal("lecombus-mqtt", work)


@bridge_command.command("notify")
@roster_option
@log_options
def notify_bridge_command(roster: Path, log_level: str, log_format: str) -> int:
    """Send messages of what happens, as the roster's `notify:` says, until SIGTERM or Ctrl-C.

    Trips, lost drives, a lost line or daemon, missed watchdogs and lapsed leases are sent by
    command or mail, many in one message: docs/notify.md. `lecombus notify test` tries it.
    """
    from lecombus.bridges.notify.bridge import run_bridge
    from lecombus.cli.notify import notify_of

    line, entry = notify_of(roster)
    set_up_logging(log_level, log_format)
    return run_until_signal("lecombus-notify", partial(run_bridge, line, entry))


def show_map(line: Roster, *, as_json: bool, markdown: bool) -> None:
    """Print which register is where."""
    from lecombus.bridges.modbus.register_map import map_markdown, roster_rows
    from lecombus.cli.screen import show_rows
    from lecombus.drives import FAMILY_NAMES

    if markdown:
        click.echo(map_markdown(FAMILY_NAMES), nl=False)
        return
    rows = roster_rows([(one.name, one.address, one.family) for one in line.drives])
    if as_json:
        click.echo(json.dumps({"line": line.line.name, "registers": rows}, ensure_ascii=False))
        return
    head = ("register", "words", "drive", "name", "part", "code", "scale", "meaning")
    show_rows(
        head, [tuple("" if row.get(key) is None else str(row[key]) for key in head) for row in rows]
    )


def extra(module: str, name: str, *libraries: str) -> Any:
    """Import what needs a library that may not be installed.

    Raises:
        CommandError: It is not.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as exc:
        if exc.name is None or exc.name.partition(".")[0] not in libraries:
            raise
        problem = f"{exc.name} is not installed, which this command needs"
        raise CommandError(Exit.FAILED, problem, f"install lecombus[{name}]") from exc


def run_until_signal(name: str, work: Callable[[], Coroutine[Any, Any, None]]) -> int:
    """Run a bridge until SIGTERM or SIGINT; returns the exit status.

    Args:
        name: What the daemon's journal and log call the process, at most 15 characters.
        work: Runs the bridge.

    Raises:
        OSError: The bridge ended with it.
    """
    import anyio  # commands that run no bridge start faster without

    with suppress(OSError):
        Path("/proc/self/comm").write_text(name, encoding="ascii")

    failures: list[OSError] = []

    async def main() -> None:
        async with anyio.create_task_group() as tasks:

            async def carry_out() -> None:
                try:
                    await work()
                except OSError as exc:  # raised below, without a group round it
                    failures.append(exc)
                tasks.cancel_scope.cancel()

            with anyio.open_signal_receiver(signal.SIGTERM, signal.SIGINT) as signals:
                tasks.start_soon(carry_out)
                async for _ in signals:
                    tasks.cancel_scope.cancel()

    anyio.run(main)
    if failures:
        raise failures[0]
    return Exit.DONE
