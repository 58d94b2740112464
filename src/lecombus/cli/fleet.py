"""`lecombus fleet`: many lines on one broker, what needs attention first, and the stop of lines.

What is known stands in `fleet.lines`; here it is asked for and printed. Nothing is printed as fine
that is not known to be so now: with the broker away every line is `unknown`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import click

from lecombus.cli.arguments import DURATION, json_option
from lecombus.cli.bridge_commands import extra
from lecombus.cli.document_rows import members_of, outcome_rows
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.fleet_screen import FleetScreen, rows_of, show_once
from lecombus.cli.screen import counted, on_terminal, progress, show_rows
from lecombus.cli.verb_commands import alarm, spoken

if TYPE_CHECKING:
    from lecombus.fleet.lines import FleetLines, LineView
    from lecombus.fleet.stopping import StopResult
    from lecombus.roster import MqttEntry

__all__ = ["fleet_command"]

PORTS: Final = {"mqtt": 1883, "mqtts": 8883}

CONNECT_WITHIN_S: Final = 5.0
QUIET_S: Final = 0.5
"""When no further line came for so long, all that stands at the broker is there."""

LOOK_EVERY_S: Final = 1.0

STOP_WITHIN_S: Final = 20.0


@dataclass(frozen=True, slots=True)
class BrokerOptions:
    """Which broker a command means.

    Args:
        entry: The broker.
        prefixes: The first levels of the topics of lines.
    """

    entry: MqttEntry
    prefixes: tuple[str, ...]

    @property
    def where(self) -> str:
        """The broker's address, for people."""
        return f"{self.entry.host}:{self.entry.port}"


Function = Callable[..., Any]

OPTIONS: Final = ("url", "roster", "topics", "username", "password_file", "ca", "certificate",
                  "key")  # fmt: skip


def broker_options(function: Function) -> Function:
    """Give a command the options that name a broker; it gets them as `given`."""

    @wraps(function)
    def command(**words: Any) -> Any:
        given = {name: words.pop(name) for name in OPTIONS}
        return function(given=given, **words)

    for names, what in (
        (("--key", "key"), "The key of --certificate."),
        (("--certificate", "certificate"), "Your own certificate (PEM), where the broker asks."),
        (("--ca", "ca"), "The authorities of its certificate (PEM); default: the system's."),
        (("--password-file", "password_file"), "The file with the password, on its first line."),
    ):
        command = click.option(*names, metavar="FILE", help=what)(command)
    command = click.option("--username", help="Who you are at the broker.")(command)
    command = click.option(
        "--topics", multiple=True, metavar="LEVELS",
        help="The first levels of the lines' topics; may be given several times; default: lecombus",
    )(command)  # fmt: skip
    command = click.option(
        "-c", "--config", "roster", metavar="ROSTER",
        type=click.Path(dir_okay=False, path_type=Path),
        help="Take broker, topics, TLS and user from `mqtt` of this roster.",
    )(command)  # fmt: skip
    return click.option(
        "--broker", "url", metavar="URL",
        help="The broker: mqtt://HOST[:PORT], or mqtts:// with TLS. Default: LECOMBUS_BROKER.",
    )(command)  # fmt: skip


@click.group("fleet", invoke_without_command=True)
@broker_options
@click.option("--once", is_flag=True, help="Show what is known now, and end.")
@click.option(
    "--expect", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
    help="Names of lines that must be there, one a line of the file.",
)  # fmt: skip
@json_option
@click.pass_context
def fleet_command(
    ctx: click.Context,
    given: Mapping[str, Any],
    once: bool,
    expect: Path | None,
    as_json: bool,
) -> int:
    """Follow all lines of a broker: which line or drive needs attention, the worst first.

    The lines need the MQTT bridge (`lecombus bridge mqtt`). A line is `ok` only while its bridge
    says so; what is old, lost or not known is never shown as fine. `lecombus fleet stop` stops
    lines.

    On a terminal it follows until Ctrl-C. In a pipe: line, what needs attention (or `ok`), drives,
    why, for how long, drives by state, age of the last news; while it follows, a line's rows when
    they change, with the time before them. With --json: one document with --once; else one a line,
    `kind` `broker` or `line`, whenever something changes. docs/fleet.md describes them.

    Exit status with --once: 0 all lines are ok; 1 something needs attention, or there is no line; 3
    the broker cannot be reached; 4 it does not permit it.
    """
    if ctx.invoked_subcommand is not None:
        ctx.obj = given
        return Exit.DONE
    broker = broker_of(given)
    expected = frozenset() if expect is None else names_in(expect)
    following = extra("lecombus.fleet.following", "mqtt", "aiomqtt", "paho")
    from lecombus.fleet.lines import FleetLines

    lines = FleetLines(broker.prefixes, expected)
    if not once:
        import anyio

        anyio.run(follow, broker, lines, as_json)
        return Exit.DONE
    read_once(broker, lines)
    views = lines.views(following.now_s())
    if as_json:
        click.echo(json.dumps(document_of(broker, lines, views), ensure_ascii=False))
    else:
        show_once(broker.where, lines, views)
    return Exit.DONE if views and all(one.status == "ok" for one in views) else Exit.FAILED


@fleet_command.command("stop")
@click.argument("names", nargs=-1, metavar="[LINE]...")
@click.option("--all", "everything", is_flag=True, help="All lines that the broker shows.")
@click.option("--target", default="all", show_default=True, help="A drive or a group of the line.")
@click.option(
    "--action", type=click.Choice(["quick-stop", "inhibit"]), default="quick-stop",
    show_default=True, help="quick-stop: down its ramp; inhibit: no torque at once, motors coast.",
)  # fmt: skip
@click.option(
    "--within", "within_s", type=DURATION, default=STOP_WITHIN_S,
    help="How long to wait for outcomes; default: 20s.",
)  # fmt: skip
@broker_options
@json_option
@click.pass_context
def stop_command(
    ctx: click.Context,
    names: Sequence[str],
    everything: bool,
    target: str,
    action: str,
    within_s: float,
    given: Mapping[str, Any],
    as_json: bool,
) -> int:
    """Stop LINE, all of its drives, through its MQTT bridge.

    As with `lecombus stop` there is no question, because a stop may be urgent; --all must be
    spelled out. Each drive's outcome comes back through the broker. It is not a safety function: a
    broker can delay and lose.

    Exit status 0 only if every drive of every line is known to have taken the stop; 3 if the broker
    cannot be reached, 4 if it does not permit it. If not, the first line, on standard error, says
    so. In a pipe: one row a drive with line, drive, code, outcome, value read back, reason. With
    --json: {"action", "target", "stops": [{"line", "outcome", "kind", "reason", "remedy",
    "answer"}]}, `answer` as of POST /v1/stop or null.
    """
    above = ctx.obj or {}
    merged = {key: value or above.get(key) for key, value in given.items()}
    stopped = "no line was asked to stop"
    try:
        if everything == bool(names):
            raise CommandError(Exit.USAGE, f"name lines, or give --all, one of both; {stopped}")
        check_target(target)
        broker = broker_of(merged)
        roots = all_roots(broker) if everything else [root_of(one, broker) for one in names]
        results = send(broker, roots, target, action, within_s, as_json=as_json)
    except (CommandError, KeyboardInterrupt):
        if not as_json:
            alarm(f"no drive has confirmed the {spoken(action)}: motors may still turn")
        raise
    if as_json:
        click.echo(stops_json(results, target, action))
    else:
        show_stops(results, action)
    if all(is_done(one) for one in results):
        return Exit.DONE
    failed = [one for one in results if not is_done(one)]
    is_forbidden = all(one.kind == "not-permitted" for one in failed)
    return Exit.FORBIDDEN if is_forbidden else Exit.FAILED


# ---- which broker, which lines ----------------------------------------------------------------


def broker_of(given: Mapping[str, Any]) -> BrokerOptions:
    """Return the broker that a command line means.

    Raises:
        CommandError: It names none, or two, or no URL of a broker.
    """
    from lecombus.roster import MqttEntry

    roster, url = given["roster"], given["url"]
    if roster is None and url is None:
        url = os.environ.get("LECOMBUS_BROKER") or None
    more = {name: given[name] for name in OPTIONS[3:] if given[name] is not None}
    if roster is not None and url is not None:
        problem = "--broker and a roster are both given"
        raise CommandError(Exit.USAGE, problem, "leave one of them out")
    if roster is not None:
        from lecombus.config import load_roster

        found = load_roster(roster).mqtt
        if found is None:
            remedy = "write the broker into it, such as `mqtt: {host: broker.example}`"
            raise CommandError(Exit.USAGE, f"{roster} has no key `mqtt`", remedy)
        entry = found.model_copy(update=more)
    elif url is not None:
        entry = MqttEntry(**address_of(url), **more)
    else:
        remedy = "give --broker mqtt://HOST, or -c ROSTER, or set LECOMBUS_BROKER"
        raise CommandError(Exit.USAGE, "which broker?", remedy)
    prefixes = tuple(dict.fromkeys(given["topics"])) or (entry.topics,)
    for one in prefixes:
        if not one.strip("/") or set(one) & set("+#\0") or one != one.strip("/"):
            raise CommandError(
                Exit.USAGE, f"--topics {one!r} is no beginning of topics", "such as plant/lecombus"
            )
    return BrokerOptions(entry, prefixes)


def address_of(url: str) -> dict[str, Any]:
    """Return host, port, TLS and user of a broker's URL.

    Raises:
        CommandError: It is none.
    """
    right = "write it like mqtt://broker.example:1883, or mqtts:// with TLS"
    try:
        found = urlsplit(url)
        port = found.port
    except ValueError as exc:
        raise CommandError(Exit.USAGE, f"`{url}` is no broker's URL: {exc}", right) from exc
    if found.scheme not in PORTS or not found.hostname or found.path.strip("/") or found.query:
        raise CommandError(Exit.USAGE, f"`{url}` is no broker's URL", right)
    if found.password is not None:
        raise CommandError(
            Exit.USAGE, "a password in the URL can be read by every user of this computer",
            "write it into a file, and name that by --password-file",
        )  # fmt: skip
    user = {} if found.username is None else {"username": found.username}
    address = {"host": found.hostname, "port": port or PORTS[found.scheme]}
    return {**address, "tls": found.scheme == "mqtts", **user}


def names_in(file: Path) -> frozenset[str]:
    """Return the names of lines in a file, one a line; what follows a `#` is left out."""
    rows = (row.partition("#")[0].strip() for row in file.read_text().splitlines())
    return frozenset(filter(None, rows))


def root_of(name: str, broker: BrokerOptions) -> str:
    """Return the first levels of the topics of a line.

    Raises:
        CommandError: No line can have this name, or it is not clear which is meant.
    """
    from lecombus.fleet.lines import NAME

    prefix, _, last = name.rpartition("/")
    if NAME.fullmatch(last) is None or (prefix and prefix not in broker.prefixes):
        raise CommandError(
            Exit.USAGE, f"no line can be called `{name}`; no line was asked to stop",
            "lecombus fleet --once shows the names",
        )  # fmt: skip
    if not prefix and len(broker.prefixes) > 1:
        right = f"write {broker.prefixes[0]}/{last}"
        raise CommandError(
            Exit.USAGE, f"`{last}` may be there under each of --topics; no line was asked to stop",
            right,
        )  # fmt: skip
    return name if prefix else f"{broker.prefixes[0]}/{last}"


def check_target(target: str) -> None:
    """Refuse a target that would be another topic, or several.

    Raises:
        CommandError: It is one.
    """
    if not target.strip() or set(target) & set("/+#\0"):
        raise CommandError(
            Exit.USAGE, "TARGET is no name of a drive or a group; no line was asked to stop",
            "name one, or all",
        )  # fmt: skip


def all_roots(broker: BrokerOptions) -> list[str]:
    """Return the first levels of the topics of all lines that the broker shows.

    Raises:
        CommandError: There is none, or the broker cannot be reached.
    """
    from lecombus.fleet.lines import FleetLines

    lines = FleetLines(broker.prefixes)
    read_once(broker, lines)
    if not lines.roots():
        raise CommandError(
            Exit.FAILED, f"{broker.where} shows no line under {', '.join(broker.prefixes)}",
            "name the lines; see whether this user may read their topics",
        )  # fmt: skip
    return sorted(lines.roots())


def read_once(broker: BrokerOptions, lines: FleetLines) -> None:
    """Read what stands at the broker.

    Raises:
        CommandError: It cannot be reached, or does not permit it.
    """
    following = extra("lecombus.fleet.following", "mqtt", "aiomqtt", "paho")
    run_with_broker(
        broker,
        partial(following.follow_once, broker.entry, lines,
                connect_within_s=CONNECT_WITHIN_S, quiet_s=QUIET_S),
    )  # fmt: skip


def run_with_broker(broker: BrokerOptions, work: Callable[[], Any]) -> Any:
    """Run what speaks with the broker.

    Raises:
        CommandError: It cannot be reached, or does not permit it.
    """
    import anyio

    from lecombus.bridges.mqtt.broker import BrokerError

    try:
        return anyio.run(work)
    except BrokerError as exc:
        status = Exit.FORBIDDEN if exc.is_refused else Exit.UNREACHABLE
        raise CommandError(status, f"the broker {broker.where}: {exc}") from exc


# ---- following --------------------------------------------------------------------------------


async def follow(broker: BrokerOptions, lines: FleetLines, as_json: bool) -> None:
    """Show the lines until cancelled."""
    import anyio

    from lecombus.fleet.following import FleetFollower, now_s

    follower = FleetFollower(broker.entry, lines)
    on_screen = on_terminal() and not as_json
    async with anyio.create_task_group() as tasks:
        tasks.start_soon(follower.run)
        with anyio.move_on_after(CONNECT_WITHIN_S):
            await follower.settled.wait()
        if on_screen:
            with FleetScreen(broker.where) as screen:
                while True:
                    screen.show(lines, lines.views(now_s()))
                    await anyio.sleep(LOOK_EVERY_S)
        changes = Changes(broker, as_json=as_json)
        while True:
            changes.show(lines, lines.views(now_s()))
            await anyio.sleep(LOOK_EVERY_S)


class Changes:
    """Prints what changed since the last time.

    Args:
        broker: The broker.
        as_json: Print JSON.
    """

    def __init__(self, broker: BrokerOptions, *, as_json: bool) -> None:
        self._broker = broker
        self._as_json = as_json
        self._marks: dict[str, object] = {}
        self._why: str | None = None

    def show(self, lines: FleetLines, views: Sequence[LineView]) -> None:
        """Print the lines that changed."""
        out = []
        if lines.why_away != self._why:
            self._why = lines.why_away
            out.append(self._broker_said(lines))
        gone = set(self._marks)
        for view in views:
            gone.discard(view.root)
            mark = mark_of(view)
            if self._marks.get(view.root) != mark:
                self._marks[view.root] = mark
                out += self._line_said(view)
        for root in gone:
            del self._marks[root]
            name = root.rpartition("/")[2]
            said = {"kind": "line", "time": time_now(), "line": name, "topics": root,
                    "status": "removed"}  # fmt: skip
            out.append(json.dumps(said) if self._as_json else f"{time_now()}\t{name}\tremoved")
        if out:
            click.echo("\n".join(out))

    def _broker_said(self, lines: FleetLines) -> str:
        if self._as_json:
            said = {"kind": "broker", "time": time_now(), "broker": self._broker.where,
                    "connected": not lines.why_away, "reason": lines.why_away or None}  # fmt: skip
            return json.dumps(said, ensure_ascii=False)
        how = f"away\t\t{lines.why_away}" if lines.why_away else "connected"
        return f"{time_now()}\tbroker {self._broker.where}\t{how}"

    def _line_said(self, view: LineView) -> list[str]:
        if self._as_json:
            said = {"kind": "line", "time": time_now(), **view.document()}
            return [json.dumps(said, ensure_ascii=False)]
        return ["\t".join((time_now(), *row)) for row in rows_of(view)]


def mark_of(view: LineView) -> object:
    """Return what makes a line worth printing again; how long something lasts does not."""
    needs = tuple((one.kind, one.drive, one.text) for one in view.needs)
    return view.status, needs, view.more, tuple(sorted(view.drives.items())), view.host


def document_of(
    broker: BrokerOptions, lines: FleetLines, views: Sequence[LineView]
) -> dict[str, Any]:
    """Return all lines as one document."""
    from lecombus.fleet.lines import total

    ok = sum(one.status == "ok" for one in views)
    return {
        "broker": broker.where, "topics": list(broker.prefixes), "time": time_now(),
        "connected": not lines.why_away, "reason": lines.why_away or None,
        "counts": {"lines": len(views), "ok": ok, "attention": len(views) - ok},
        "drives": total(views, lambda one: one.drives), "ignored": lines.ignored,
        "left_out": lines.left_out, "lines": [one.document() for one in views],
    }  # fmt: skip


def time_now() -> str:
    """Return the time as the daemon writes it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


# ---- stops ------------------------------------------------------------------------------------


def send(
    broker: BrokerOptions,
    roots: Sequence[str],
    target: str,
    action: str,
    within_s: float,
    *,
    as_json: bool,
) -> list[StopResult]:
    """Stop lines, and show on a terminal how many have answered.

    Raises:
        CommandError: The broker cannot be reached: nothing was sent.
    """
    stopping = extra("lecombus.fleet.stopping", "mqtt", "aiomqtt", "paho")
    answered = 0
    with progress(f"{action} of {counted(len(roots), 'line')}", quiet=as_json) as bar:

        def heard(result: StopResult) -> None:
            nonlocal answered
            answered += 1
            bar.advance(answered, len(roots))

        found: list[StopResult] = run_with_broker(
            broker,
            partial(stopping.send_stops, broker.entry, roots, target, action, within_s, heard),
        )
        return found


def is_done(result: StopResult) -> bool:
    """Whether every drive of the line is known to have taken the stop."""
    if result.answer is None or not result.is_done:
        return False
    return all(one.get("outcome") in ("done", "verified") for one in members_of(result.answer))


def show_stops(results: Sequence[StopResult], action: str) -> None:
    """Print how the stops ended; first of all, on standard error, that some are not confirmed."""
    doubtful = sum(not is_done(one) for one in results)
    if doubtful:
        lines = "line" if len(results) == 1 else "lines"
        alarm(
            f"{doubtful} of {len(results)} {lines} did not confirm the {spoken(action)} of every "
            "drive: motors may still turn"
        )
    rows: list[tuple[str, ...]] = []
    for one in results:
        name = one.root.rpartition("/")[2]
        if one.answer is not None and one.answer.get("members"):
            rows += [(name, *row) for row in outcome_rows(members_of(one.answer))]
        elif one.answer is not None and one.is_done:
            rows += [(name, *row) for row in outcome_rows([one.answer])]
        else:
            why = "; ".join(filter(None, (one.reason, one.remedy)))
            rows.append((name, "", "", one.outcome, "", why))
    show_rows(("line", "drive", "code", "outcome", "reads", "why"), rows)


def stops_json(results: Sequence[StopResult], target: str, action: str) -> str:
    """Return the results as one document; answers as they came, their decimals exactly."""
    stops = []
    for one in results:
        said = {"line": one.root.rpartition("/")[2], "topics": one.root, "outcome": one.outcome,
                "kind": one.kind or None, "reason": one.reason or None,
                "remedy": one.remedy or None}  # fmt: skip
        stops.append(
            f'{json.dumps(said, ensure_ascii=False)[:-1]}, "answer": {one.text or "null"}}}'
        )
    head = json.dumps({"action": action, "target": target}, ensure_ascii=False)[:-1]
    return f'{head}, "stops": [{", ".join(stops)}]}}'
