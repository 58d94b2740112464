"""`lecombus plan`: what a line can hold and how long requests wait, before it runs or beside it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click

from lecombus.capacity.facts import roster_of, slow_of
from lecombus.capacity.live import LivePlan, compare
from lecombus.capacity.plan import LinePlan, make_plan
from lecombus.capacity.timeline import Preview, picture, preview
from lecombus.capacity.watchdog_feasibility import InfeasibleWatchdog, find_infeasible, rounded_up
from lecombus.cli.arguments import DaemonOptions, daemon_options
from lecombus.cli.daemon_access import ask
from lecombus.cli.document_rows import shown_code, spoken_code
from lecombus.cli.exits import CommandError, Exit
from lecombus.cli.screen import counted, show_table
from lecombus.cli.whole_file import write_whole
from lecombus.client.documents import Answer
from lecombus.config import DriveEntry, Roster, line_timing, load_roster
from lecombus.durations import format_duration
from lecombus.metrics.rolling_window import WINDOW_S
from lecombus.schedule.shares import LISTEN_EVERY_S, LISTEN_S

__all__ = ["plan_command"]

Answers = Mapping[str, Sequence[Mapping[str, Any]]]
"""By drive: what was measured of each code, as `capacity.facts.answers_of` gives it."""

Families = Mapping[str, str]
"""By drive: the name of its family."""

SILENCE = (
    "while drives that do not answer are being stopped, no class but the stops of others is held "
    "to this: all else waits seconds for each of them"
)


@click.command("plan")
@click.option(
    "-c",
    "--config",
    "roster",
    metavar="ROSTER",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The roster: a YAML file that describes the line.",
)
@click.option("--live", is_flag=True, help="Compare the running daemon's line with its promise.")
@click.option(
    "--from-daemon",
    is_flag=True,
    help="Plan with the answer times that the running daemon has measured.",
)
@daemon_options
@click.option(
    "--svg",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Draw the line over one hyperperiod into FILE.",
)
def plan_command(
    roster: Path | None,
    live: bool,
    from_daemon: bool,
    daemon: DaemonOptions,
    svg: Path | None,
) -> int:
    """Say what a line can hold and how long requests wait at most, before it runs.

    No port is opened. A roster whose watchdogs cannot be held is refused with the arithmetic,
    as by check. The promises hold while every drive answers and at most one exchange is lost,
    and not while drives that do not answer are being stopped. A computer that does not run the
    daemon adds its pause. They are calculated with the same costs that the schedule and the
    time-outs use.

    With --live the running daemon is asked instead of a roster (--socket, --url): its promises
    are compared with the last five minutes of its line, and what is beyond them is named. With
    --from-daemon the plan is that of the running roster, or of ROSTER, with the answer times
    that the daemon has measured, and the drives that are slower than their manual are named.
    """
    if live and from_daemon:
        raise click.UsageError("--live and --from-daemon are two different tables: give one")
    if live:
        return _live(roster, svg, daemon)
    if from_daemon:
        loaded, answers = measured_roster(roster, daemon)
    elif roster is None:
        raise click.UsageError("-c ROSTER is missing; or --live for the line that is running")
    elif daemon.socket or daemon.url:
        raise click.UsageError("--socket and --url need --live or --from-daemon")
    else:
        loaded, answers = load_roster(roster), None
    plan, shown = make_plan(loaded), preview(loaded, line_timing(loaded.line))
    if svg is not None:
        _draw(loaded, shown, svg, roster)
    unheld = [] if answers is None else find_infeasible(loaded)
    if daemon.as_json:
        more = {} if answers is None else {"answers": answers, "unheld": list(map(asdict, unheld))}
        run = {"run": shown.as_json()}
        click.echo(json.dumps(plan.as_json() | run | more, ensure_ascii=False))
    else:
        _show(plan, shown, families_of(loaded))
        if answers is not None:
            show_answers(answers, families_of(loaded))
            show_unheld(unheld)
    return Exit.DONE


def _live(roster: Path | None, svg: Path | None, daemon: DaemonOptions) -> int:
    if roster is not None or svg is not None:
        raise click.UsageError("--live takes the running daemon's roster: leave out -c and --svg")
    found, running = live_of(ask(daemon, "/v1/plan"))
    if daemon.as_json:
        click.echo(json.dumps(found.as_json(), ensure_ascii=False))
    else:
        show_live(found, families_of(running))
    return Exit.DONE


def _draw(roster: Roster, shown: Preview, file: Path, read_from: Path | None) -> None:
    if read_from is not None and file.exists() and file.samefile(read_from):
        raise click.UsageError(f"{file} is the roster: draw into another file")
    names = tuple(drive.name for drive in roster.drives)
    title = f"line {roster.line.name}, {roster.line.baud} baud: who speaks when"
    write_whole(file, picture(title, names, shown), may_replace=True)


def _show(plan: LinePlan, shown: Preview, families: Families) -> None:
    load = plan.load
    click.echo(
        f"line {plan.line} at {plan.baud} baud: {load.total:.0%} of it is asked for "
        f"(cyclic reads {load.cyclic:.0%}, feeds beside them {load.feeding:.0%})"
    )
    if load.stretch > 1.0:
        click.echo(f"that is too much: every cyclic period is stretched by {plan.stretch:.2f}")
    elif plan.stretch > 1.0:
        click.echo(
            "feeds that keep room for lost answers take turns with the reads: every cyclic period "
            f"is stretched by {plan.stretch:.2f}"
        )
    click.echo(
        f"run by the schedule: {shown.total:.0%} of it is taken (reads {shown.cyclic:.0%}, feeds "
        f"{shown.feeding:.0%}; a line that has time feeds early)"
    )
    _show_adapter(plan)
    _show_room(plan)
    _show_waits(plan)
    _show_leases(plan)
    _show_watchdogs(plan)
    _show_exchanges(plan, families)
    _show_effects(plan)


def _show_adapter(plan: LinePlan) -> None:
    """Say what becomes of the line if the adapter is as slow as the roster lets it be."""
    one = plan.adapter
    verdict = "every watchdog is held"
    if not plan.watchdogs:
        verdict = "no watchdog is fed"
    elif not one.held:
        raised = "no time" if one.least_s is None else f"a time of {rounded_up(one.least_s)}"
        verdict = f"not every watchdog is held: {raised} would do"
    click.echo(
        f"if the adapter adds its {format_duration(one.latency_s)} to every answer: "
        f"{one.load.total:.0%} is asked for, {verdict}"
    )


def _show_waits(plan: LinePlan) -> None:
    rows = [
        (one.name, _time(one.quiet_s), _time(one.loaded_s), _time(one.own_s), one.counts)
        for one in plan.waits
    ]
    silent = plan.silent_stop
    text = f"{silent.counts}; {counted(silent.telegrams, 'telegram')} at least"
    times = _time(silent.quiet_s), _time(silent.loaded_s), _time(silent.attempt_s)
    rows.insert(1, ("stop, silent drive", *times, text))
    click.echo(SILENCE)
    show_table(
        ("class", "begins within", "under load", "own exchange", "what is counted"), rows,
        title="how long one request waits at most",
    )  # fmt: skip
    show_table(
        ("class", "share of the line", "begins within"),
        [
            (one.name, f"{one.share:.0%}", _time(one.crowded_s))
            for one in plan.waits
            if one.share is not None
        ],
        title="how long the first request of a class waits at most, whatever others ask for",
    )


def _show_room(plan: LinePlan) -> None:
    """Say which exchanges the watchdogs leave no time for, and which only when it happens so."""
    room = plan.room
    if not plan.watchdogs:
        return
    if room.most_s <= 0.0:
        click.echo("the watchdogs leave no time for anything but feeds")
        return
    some = ""
    if room.sure_s < room.most_s:
        some = (
            f"; one that needs more than {_time(room.sure_s)}, with what may be lost behind it, "
            "waits for a moment that fits"
        )
    click.echo(
        f"an exchange that may hold the line for more than {_time(room.failed_s)} is refused: the "
        f"watchdogs never leave more{some}"
    )
    if room.answered_s < room.most_s:
        click.echo(
            f"one that takes more than {_time(room.answered_s)} when it is answered is refused, "
            "too: a stop behind it, with one lost answer, would make a watchdog act"
        )


def _show_leases(plan: LinePlan) -> None:
    """Say how soon each drive that needs a lease is stopped after its client's last renewal."""
    if plan.leases:
        show_table(
            ("drive", "on lapse", "lease", "stop begins within", "its watchdog, if need be",
             "what is counted"),
            [
                (one.drive, one.on_lapse, format_duration(one.time_s), _time(one.stop_s),
                 _time(one.watchdog_s), one.counts)
                for one in plan.leases
            ],
            title="how soon a drive is stopped after its client's last sign of life",
        )  # fmt: skip


def _show_watchdogs(plan: LinePlan) -> None:
    if not plan.watchdogs:
        return
    show_table(
        ("drive", "watchdog", "a feed", "least held", "a drive may go", "outlasts lost answers",
         "a restart", "verdict"),
        [
            (one.drive, format_duration(one.time_s), _time(one.feed_s), _time(one.least_s),
             _time(one.outlasts_s), str(one.lost), one.at_restart,
             one.verdict)
            for one in plan.watchdogs
        ],
        title="watchdogs",
    )  # fmt: skip


def _show_exchanges(plan: LinePlan, families: Families) -> None:
    show_table(
        ("drive", "what", "asked every", "reached", "usual", "one failed attempt", "at most"),
        [
            (one.drive, shown_code(families.get(one.drive), one.what),
             format_duration(one.every_s), _time(one.cycle_s), _time(one.times.usual_s),
             _time(one.times.worst_s), _time(one.most_s))
            for one in plan.exchanges
        ],
        title="exchanges",
    )  # fmt: skip


def _show_effects(plan: LinePlan) -> None:
    show_table(
        ("baud", "asked for", "cycles", "watchdogs", "least time for all"),
        [
            (str(one.baud), f"{one.load.total:.0%}", f"x{one.load.stretch:.2f}",
             "held" if one.held else "not held", _time(one.least_s))
            for one in plan.bauds
        ],
        title="at other baud rates",
    )  # fmt: skip
    if plan.absent:
        listening = f"{format_duration(LISTEN_S)} in {format_duration(LISTEN_EVERY_S)}"
        show_table(
            ("absent", f"asked for, with {listening} of listening", "cycle rate of the others"),
            [
                (str(one.absent), f"{one.load.total:.0%}", f"x{one.cycle_rate:.2f}")
                for one in plan.absent
            ],
            title="with drives away",
        )


def families_of(roster: Roster) -> Families:
    """Give the drives' families, by name."""
    return {drive.name: drive.family for drive in roster.drives}


def live_of(answer: Answer) -> tuple[LivePlan, Roster]:
    """Compare what a daemon gives; return it with the daemon's roster.

    Raises:
        CommandError: It speaks another version.
    """
    with _understood():
        document = json.loads(answer.text)
        roster, measured = roster_of(document["roster"]), document["measured"]
        return compare(roster, measured, document["away"], document["state"]), roster


def measured_roster(file: Path | None, daemon: DaemonOptions) -> tuple[Roster, Answers]:
    """Give a roster with the answer times that a running daemon has measured.

    Args:
        file: The roster; None: the one that is running.
        daemon: Which daemon.

    Returns:
        The roster, and what was measured of its drives.

    Raises:
        CommandError: There is no daemon, or it speaks another version.
    """
    wanted = None if file is None else load_roster(file)
    answer = ask(daemon, "/v1/plan")
    with _understood():
        document = json.loads(answer.text)
        roster, slow = roster_of(document["roster"]), slow_of(document["roster"])
        answers: Answers = document["answers"]
    if wanted is None:
        return roster, answers
    drives = tuple(
        drive.model_copy(update={"slow": slow[drive.name]})
        if _is_same(drive, roster.drive(drive.name))
        else drive
        for drive in wanted.drives
    )
    known = {drive.name for drive in drives if _is_same(drive, roster.drive(drive.name))}
    return (
        wanted.model_copy(update={"drives": drives}),
        {name: rows for name, rows in answers.items() if name in known},
    )


def _is_same(drive: DriveEntry, running: DriveEntry | None) -> bool:
    """Whether what was measured of a running drive was measured of this one."""
    return running is not None and (drive.family, drive.address) == (
        running.family,
        running.address,
    )


@contextmanager
def _understood() -> Iterator[None]:
    try:
        yield
    except (KeyError, TypeError, ValueError) as exc:
        problem = "the daemon describes its line in a way that this lecombus does not know"
        remedy = "use the command of the daemon's own version"
        raise CommandError(Exit.FAILED, problem, remedy) from exc


def show_answers(answers: Answers, families: Families) -> None:
    """Write which drives and codes differ from their manual."""
    rows = [
        (drive, shown_code(families.get(drive), row["code"]) + (" written" if row["write"] else ""),
         _time(row["manual_s"]), _time(row["measured_s"]))
        for drive, of_drive in answers.items()
        for row in of_drive
        if row["slow"]
    ]  # fmt: skip
    if not answers:
        click.echo("\nno drive of the roster is on the daemon's line: nothing was measured of it")
        return
    if not rows:
        click.echo("\nno drive answers later than its manual says")
        return
    show_table(
        ("drive", "code", "manual", "measured"), rows, title="answered later than the manual says"
    )


def show_unheld(unheld: Sequence[InfeasibleWatchdog]) -> None:
    """Write which watchdogs cannot be held with the answer times that were measured."""
    for one in unheld:
        click.echo(f"\n{one.drive}: {one.what}; {one.right}")


def show_live(live: LivePlan, families: Families) -> None:
    """Write it for people."""
    slack = "" if live.slack_s is None else f"; least slack {_time(live.slack_s)}"
    click.echo(
        f"line {live.line} at {live.baud} baud, the last {live.window_s:.0f} s: {live.used:.0%} of "
        f"it was taken, {live.load:.0%} is asked for all the time{slack}"
    )
    if live.window_s < WINDOW_S:
        click.echo("that is since its start, when drives are audited: ask again later")
    if live.failed:
        click.echo(
            f"{counted(live.failed, 'exchange')} without an answer; promises hold while drives "
            "answer and at most the exchange under way is lost"
        )
    _show_classes(live)
    _show_drives(live)
    _show_codes(live, families)
    click.echo()
    beyond = _spoken(live, families).beyond
    if not beyond:
        click.echo("nothing is beyond what was promised")
    for text in beyond:
        click.echo(f"beyond the promise: {text}")


def _show_classes(live: LivePlan) -> None:
    show_table(
        ("class", "promised", "loaded", "half within", "longest", "waits", "asked", "taken", ""),
        [
            (one.name, _time(one.quiet_s), _time(one.loaded_s), _time(one.median_s),
             _time(one.most_s), str(one.waits), "" if one.load is None else f"{one.load:.1%}",
             f"{one.used:.1%}", one.verdict)
            for one in live.classes
        ],
        title="how long requests waited; others of the same class and above come on top",
    )  # fmt: skip


def _show_drives(live: LivePlan) -> None:
    if not live.drives:
        return
    show_table(
        ("drive", "watchdog", "left, promised", "left, least", ""),
        [
            (one.drive, format_duration(one.time_s), _time(one.promised_s), _time(one.least_s),
             one.verdict)
            for one in live.drives
        ],
        title="watchdogs",
    )  # fmt: skip


def _show_codes(live: LivePlan, families: Families) -> None:
    show_table(
        ("drive", "code", "asked every", "promised", "loaded", "longest gap", ""),
        [
            (one.drive, shown_code(families.get(one.drive), one.code),
             format_duration(one.asked_s), _time(one.promised_s), _time(one.loaded_s),
             _time(one.longest_s), one.verdict)
            for one in live.codes
        ],
        title="cyclic reads",
    )  # fmt: skip


def _spoken(live: LivePlan, families: Families) -> LivePlan:
    """Give it with codes named as the drives' keypads do, for sentences."""
    return replace(
        live,
        codes=tuple(
            replace(one, code=spoken_code(families.get(one.drive), one.code)) for one in live.codes
        ),
    )


def _time(seconds: float | None) -> str:
    if seconds is None:
        return "none"
    if math.isinf(seconds):
        return "no promise"
    if abs(seconds) < 1.0:
        return f"{seconds * 1000:.0f} ms"
    return f"{seconds:.2f} s"
