"""Our instruments say what prometheus_client's say of the same numbers."""

from __future__ import annotations

import prometheus_client
from hypothesis import given
from hypothesis import strategies as st

from lecombus.metrics.counters import Counter, Histogram
from lecombus.metrics.exposition import sample_lines

BOUNDS = (0.005, 0.1, 1.0, 10.0)
LABELS = {"line": 'hall "3"', "kind": "read"}
near_bounds = st.sampled_from([0.0, *BOUNDS, *(bound * 1.0000001 for bound in BOUNDS), 1e9])


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
