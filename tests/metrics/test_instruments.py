"""Our instruments say what prometheus_client's say of the same numbers."""

from __future__ import annotations

from pathlib import Path

import prometheus_client
import pytest
from hypothesis import given
from hypothesis import strategies as st
from prometheus_client import Metric, ProcessCollector

from lecombus.metrics.exposition import join_blocks, labels_text
from lecombus.metrics.instruments import Counter, Histogram
from lecombus.metrics.process_figures import process_blocks

BOUNDS = (0.005, 0.1, 1.0, 10.0)
LABELS = {"line": 'hall "3"', "kind": "read"}
near_bounds = st.sampled_from([0.0, *BOUNDS, *(bound * 1.0000001 for bound in BOUNDS), 1e9])


def sample_lines(metric: Metric) -> list[str]:
    """The lines of what a prometheus_client object collects, without times of creation."""
    return [
        f"{one.name}{labels_text(one.labels)} {one.value!r}"
        for one in metric.samples
        if not one.name.endswith("_created")
    ]


@given(st.lists(near_bounds | st.floats(0.0, 20.0)))
def test_a_histogram_is_written_as_prometheus_client_writes_it(values: list[float]) -> None:
    theirs = prometheus_client.Histogram("x", "X.", list(LABELS), registry=None, buckets=BOUNDS)
    child = theirs.labels(*LABELS.values())
    ours = Histogram(LABELS, BOUNDS)
    for value in values:
        child.observe(value)
        ours.observe(value)
    (metric,) = theirs.collect()
    assert ours.lines("x") == sample_lines(metric)


@given(st.lists(st.floats(0.0, 1e6)))
def test_a_counter_is_written_as_prometheus_client_writes_it(steps: list[float]) -> None:
    theirs = prometheus_client.Counter("x_total", "X.", list(LABELS), registry=None)
    child = theirs.labels(*LABELS.values())
    ours = Counter(LABELS)
    for step in steps:
        child.inc(step)
        ours.inc(step)
    (metric,) = theirs.collect()
    assert ours.lines("x") == sample_lines(metric)


def test_the_process_is_described_as_prometheus_client_describes_it() -> None:
    theirs = list(ProcessCollector(registry=None).collect())
    ours = process_blocks()
    told = [(one.name, one.type, one.documentation) for one in theirs]
    assert [(one.name, one.kind, one.help) for one in ours] == told
    for block, metric in zip(ours, theirs, strict=True):
        ((name, number),) = (line.split() for line in block.lines)
        ((their_name, their_number),) = (line.split() for line in sample_lines(metric))
        assert name == their_name
        assert ("." in number) == ("." in their_number)
        assert float(number) == pytest.approx(float(their_number), rel=0.2, abs=5.0)


def test_figures_that_the_kernel_does_not_give_are_left_out(tmp_path: Path) -> None:
    assert process_blocks(tmp_path) == []
    (tmp_path / "self" / "fd").mkdir(parents=True)
    (tmp_path / "self" / "fd" / "0").touch()
    (tmp_path / "self" / "limits").write_text("Max open files            1024      4096   files\n")
    for block in (blocks := process_blocks(tmp_path)):
        block.close()
    page = join_blocks(blocks, openmetrics=True).decode()
    assert "process_open_fds 1\n" in page
    assert "process_max_fds 1024.0\n" in page
    assert "process_cpu_seconds" not in page
