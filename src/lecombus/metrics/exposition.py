"""Lines of a metrics page, in the two text formats Prometheus reads.

Strategy: a family is a heading and its sample lines. Sample lines are the same in both formats;
only headings differ (OpenMetrics names a counter without `_total` and wants an end mark), so a
page is rendered once and put together twice. prometheus_client's own writers are not used
because they render a whole registry in one go, which takes milliseconds in which no telegram
could be sent.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Final

from prometheus_client import Metric

__all__ = [
    "OPENMETRICS_TYPE",
    "TEXT_TYPE",
    "Block",
    "escape",
    "join_blocks",
    "labels_text",
    "sample_lines",
    "wants_openmetrics",
]

TEXT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
OPENMETRICS_TYPE: Final = "application/openmetrics-text; version=1.0.0; charset=utf-8"


@dataclass(slots=True, eq=False)
class Block:
    """One family: heading and sample lines.

    Args:
        name: Its name, without `_total`.
        kind: `counter`, `gauge` or `histogram`.
        help: One sentence for people.
        lines: Its samples, until it is closed.
        body: Its samples as bytes, once it is closed.
    """

    name: str
    kind: str
    help: str
    lines: list[str] = field(default_factory=list)
    body: bytes = b""

    def add(self, labels: str, value: float | Decimal) -> None:
        """Add a sample; `labels`: as they stand between braces."""
        suffix = "_total" if self.kind == "counter" else ""
        text = format(value, "f") if isinstance(value, Decimal) else repr(value)
        self.lines.append(f"{self.name}{suffix}{{{labels}}} {text}")

    def close(self) -> None:
        """Put the samples together; both formats share them, and a page is then a short join."""
        self.body = "".join([f"{line}\n" for line in self.lines]).encode()
        self.lines = []

    def text(self, *, openmetrics: bool) -> bytes:
        """Return heading and samples of a closed family, or nothing when there is no sample."""
        if not self.body:
            return b""
        name, kind = self.name, self.kind
        if kind == "counter" and not openmetrics:
            name += "_total"
        if kind == "unknown" and not openmetrics:
            kind = "untyped"
        quoted = self.help.replace("\\", "\\\\").replace("\n", "\\n")
        if openmetrics:
            quoted = quoted.replace('"', '\\"')
        return f"# HELP {name} {quoted}\n# TYPE {name} {kind}\n".encode() + self.body


def escape(text: str) -> str:
    """Return a label value as it stands between quotes."""
    return text.replace("\\", "\\\\").replace("\n", "\\n").replace('"', '\\"')


def labels_text(labels: Mapping[str, str]) -> str:
    """Return labels in braces, or nothing when there are none."""
    if not labels:
        return ""
    return "{" + ",".join(f'{name}="{escape(value)}"' for name, value in labels.items()) + "}"


def sample_lines(metric: Metric) -> list[str]:
    """Return the sample lines of what a prometheus_client object collects.

    Creation times are left out: they double the page and are not used here.
    """
    return [
        f"{one.name}{labels_text(one.labels)} {one.value!r}"
        for one in metric.samples
        if not one.name.endswith("_created")
    ]


def join_blocks(blocks: Iterable[Block], *, openmetrics: bool) -> bytes:
    """Return a whole page."""
    page = b"".join([block.text(openmetrics=openmetrics) for block in blocks])
    return page + b"# EOF\n" if openmetrics else page


def wants_openmetrics(accept: str) -> bool:
    """Return from an `Accept` header whether OpenMetrics is liked at least as well as text."""
    best = {"application/openmetrics-text": 0.0, "text/plain": 0.0}
    for part in accept.lower().split(","):
        kind, *parameters = (piece.strip() for piece in part.split(";"))
        if kind in best:
            best[kind] = max(best[kind], quality_of(parameters))
    return best["application/openmetrics-text"] > 0 and (
        best["application/openmetrics-text"] >= best["text/plain"]
    )


def quality_of(parameters: Iterable[str]) -> float:
    """Return the `q` among the parameters of a media range, 0..1; 1 when there is none."""
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name.strip() == "q":
            try:
                return min(1.0, max(0.0, float(value)))
            except ValueError:
                return 0.0
    return 1.0
