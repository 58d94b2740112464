"""`lecombus fleet stop`: the stop of whole lines, with the outcome of every drive.

A line counts as stopped only if all of its drives are known to have taken the stop. If a line of
drives is not stopped, the first line on standard error says so.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import click

from lecombus.cli.arguments import DURATION, json_option
from lecombus.cli.bridge_commands import extra
from lecombus.cli.document_rows import members_of, outcome_rows
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.fleet_broker import (
    BrokerOptions,
    broker_of,
    broker_options,
    read_once,
    run_with_broker,
)
from lecombus.cli.screen import counted, progress, show_rows
from lecombus.cli.verb_commands import alarm, spoken

if TYPE_CHECKING:
    from lecombus.fleet.stopping import StopResult

__all__ = ["stop_command"]

STOP_WITHIN_S: Final = 20.0


@click.command("stop")
@click.argument("names", nargs=-1, metavar="[LINE]...")
@click.option("--all", "everything", is_flag=True, help="All lines that the broker shows.")
@click.option("--target", default="all", show_default=True, help="A drive or a group of the line.")
@click.option(
    "--action", type=click.Choice(["quick-stop", "inhibit"]), default="quick-stop",
    show_default=True, help="quick-stop: down its ramp; inhibit: no torque, motors coast.",
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
    as_json = as_json or bool(above.get("as_json"))
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
    say_if_not_confirmed(results, action)
    if as_json:
        click.echo(stops_json(results, target, action))
    else:
        show_stops(results)
    if all(is_done(one) for one in results):
        return Exit.DONE
    failed = [one for one in results if not is_done(one)]
    is_forbidden = all(one.kind == "not-permitted" for one in failed)
    return Exit.FORBIDDEN if is_forbidden else Exit.FAILED


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
            Exit.USAGE, "TARGET is not a name of a drive or a group; no line was asked to stop",
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


def say_if_not_confirmed(results: Sequence[StopResult], action: str) -> None:
    """Say on standard error, before all else, that some stops are not confirmed."""
    doubtful = sum(not is_done(one) for one in results)
    if doubtful:
        lines = "line" if len(results) == 1 else "lines"
        alarm(
            f"{doubtful} of {len(results)} {lines} did not confirm the {spoken(action)} of every "
            "drive: motors may still turn"
        )


def show_stops(results: Sequence[StopResult]) -> None:
    """Print how the stops ended."""
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
