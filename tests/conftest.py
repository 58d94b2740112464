"""What holds for every test.

A test on the real clock shares its machine with whatever else runs there: a processor taken away
for half a second can make a right program miss a real time-out. Such a test that fails is run twice
more, and the run says so at its end; it fails if it fails three times. Tests of pure rooms and of
whole lines on the virtual clock are never repeated: what fails there once is wrong.
"""

from pathlib import Path

import hypothesis
import pytest

# How long an example takes says more of the machine than of us: nothing is judged by the clock.
hypothesis.settings.register_profile("lecombus", deadline=None)
hypothesis.settings.load_profile("lecombus")

HERE = Path(__file__).parent

REPEATED = 2

ON_THE_CLOCK = frozenset({"api", "cli", "demo", "line", "real", "simulator"})
"""Folders whose tests may open sockets, pseudo terminals and processes."""

COUNTED = "counted"
"""The property under which a test leaves a line that the run shows at its end."""

LEAST_TIMEOUT_S = 60
"""For tests marked `real`: processes are started there, on a machine that may be busy."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        on_the_clock = item.path.relative_to(HERE).parts[0] in ON_THE_CLOCK
        real = item.get_closest_marker("real") is not None
        if on_the_clock or real:
            item.add_marker(pytest.mark.flaky(reruns=REPEATED, reruns_delay=1))
        if real and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(LEAST_TIMEOUT_S))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    show_counts(terminalreporter)
    repeated = terminalreporter.stats.get("rerun", [])
    if repeated:
        terminalreporter.section("repeated, because they failed on a real clock")
        for report in repeated:
            terminalreporter.write_line(report.nodeid)


def show_counts(terminalreporter: pytest.TerminalReporter) -> None:
    """Say what tests counted: those that call `record_property("counted", text)`."""
    counted = [
        text
        for report in terminalreporter.stats.get("passed", [])
        for key, text in report.user_properties
        if key == COUNTED
    ]
    if counted:
        terminalreporter.section("counted")
        for text in counted:
            terminalreporter.write_line(str(text))
