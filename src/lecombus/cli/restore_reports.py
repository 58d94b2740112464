"""What a restore prints: its plan before, its result after; for people, pipes and programs."""

from __future__ import annotations

import click

from lecombus.backups import Restored, RestorePlan, RestoreStep, Skip
from lecombus.cli.screen import counted, on_terminal, show_rows
from lecombus.protocol import Value
from lecombus.readings import Json

__all__ = ["plan_json", "result_json", "show_interrupted", "show_plan", "show_result"]


def show_plan(plan: RestorePlan, drive: str, *, enabled: bool | None, enable: bool) -> None:
    """Print what would be written, what is left out, and what should be known before.

    Args:
        plan: The plan.
        drive: The drive's name.
        enabled: It is enabled now; None where it does not say.
        enable: It shall be enabled again at the end.
    """
    if on_terminal():
        click.echo(headline(plan, drive))
    rows = [
        (
            "write", str(step.code), step.name, told(step.now, step.now_means),
            told(step.value, step.value_means), step.unit or "", step.because,
        )
        for step in plan.steps
    ]  # fmt: skip
    rows += [
        ("skip", str(skip.code), skip.name, "", "", "", skip.why) for skip in worth_telling(plan)
    ]
    if rows:
        show_rows(("", "code", "name", "now", "then", "unit", "why"), rows)
    for remark in plan.remarks:
        click.echo(remark, err=True)
    if plan.steps and enabled:
        after = "enabled again at the end: the motor may turn" if enable else "stays so"
        click.echo(f"{drive} is enabled: it will be inhibited, and {after}", err=True)
    if plan.save is not None and plan.steps:
        click.echo(f"at the end {plan.save[0]} = {plan.save[1]} saves it all", err=True)


def headline(plan: RestorePlan, drive: str) -> str:
    """Return the plan in one line."""
    expected = sum(skip.expected for skip in plan.skips)
    parts = [f"{len(plan.steps)} to write", f"{len(plan.same)} right already"]
    if others := len(plan.skips) - expected:
        parts.append(f"{others} left out")
    if expected:
        parts.append(f"{expected} process values and the like")
    return f"{drive}: " + ", ".join(parts)


def worth_telling(plan: RestorePlan) -> list[Skip]:
    """Give what is left out and somebody might miss: not every process value."""
    return [skip for skip in plan.skips if not skip.expected]


def told(value: Value, meaning: str) -> str:
    """Return a value with its meaning."""
    return f"{value} ({meaning})" if meaning else value.raw


def show_result(plan: RestorePlan, result: Restored, drive: str, *, enabled: bool) -> None:
    """Print how it ended."""
    rows = [
        (str(code), "refused", plan.wanted[code].raw, "", why)
        for code, why in result.refused.items()
    ]
    rows += [
        (
            str(code), "changed", value.raw, answer.value.raw if answer.value else "",
            answer.text or "somebody else wrote it, or the drive did not keep it",
        )
        for code, (value, answer) in result.changed.items()
    ]  # fmt: skip
    if rows:
        show_rows(("code", "outcome", "wanted", "reads", "why"), rows)
    if result.stopped:
        click.echo(f"stopped: {result.stopped}", err=True)
        if result.written:
            click.echo(f"written: {', '.join(map(str, result.written))}", err=True)
    written = counted(len(result.written), "code")
    if result.complete:
        saved = " and saved" if result.saved else ""
        click.echo(f"{drive}: {written} written and read back{saved}, all as in the file")
    else:
        rest = "run it again: it goes on with what is missing"
        click.echo(f"{drive}: {written} written, not complete; {rest}", err=True)
        if result.saved is False:
            click.echo("not saved: what was written is lost at power-off", err=True)
    if enabled:
        click.echo(f"{drive} is enabled again")
    elif result.inhibited_here and result.inhibited_now:
        click.echo(f"{drive} is inhibited: enable it yourself, when it may move")
    elif result.inhibited_now is not True:
        told = "is not" if result.inhibited_now is False else "does not say whether it is"
        click.echo(f"{drive} {told} inhibited now: take it for one that may start", err=True)


def show_interrupted(plan: RestorePlan, result: Restored, drive: str) -> None:
    """Say what a restore that was cut short by Ctrl-C has done, and how to go on."""
    written = len(result.written)
    of = f"{written} of {counted(len(plan.steps), 'code')}"
    more = "" if written == len(plan.steps) else "; the one under way may have been written too"
    holds = "stays inhibited and holds" if written else "may be inhibited and hold"
    click.echo(
        f"interrupted: {of} written to {drive} and read back{more}; it {holds} a part of the "
        "backup. Run the same command again: it goes on with what is missing",
        err=True,
    )


def plan_json(plan: RestorePlan, drive: str) -> dict[str, Json]:
    """Return the plan's JSON form."""
    return {
        "drive": drive,
        "blockers": list(plan.blockers),
        "remarks": list(plan.remarks),
        "write": [step_json(step) for step in plan.steps],
        "same": [str(code) for code in plan.same],
        "skip": [{"code": str(s.code), "name": s.name, "reason": s.why} for s in plan.skips],
    }


def step_json(step: RestoreStep) -> dict[str, Json]:
    """Return the JSON form of one write."""
    return {
        "code": str(step.code),
        "name": step.name,
        "unit": step.unit,
        "now": step.now.raw,
        "then": step.value.raw,
        "reason": step.because or None,
    }


def result_json(plan: RestorePlan, result: Restored, drive: str) -> dict[str, Json]:
    """Return the result's JSON form, with the plan it came from."""
    return {
        **plan_json(plan, drive),
        "complete": result.complete,
        "written": [str(code) for code in result.written],
        "refused": [{"code": str(code), "reason": why} for code, why in result.refused.items()],
        "changed": [
            {
                "code": str(code),
                "wanted": value.raw,
                "reads": None if answer.value is None else answer.value.raw,
            }
            for code, (value, answer) in result.changed.items()
        ],
        "stopped": result.stopped or None,
        "inhibited": result.inhibited_here and result.inhibited_now is True,
        "saved": result.saved,
    }
