"""Panels as all dashboards of lecombus have them.

Grey is normal (ISA-101): colour shows only what a person must look at, yellow for what can become
worse, red for what stands or cannot be reached. Every panel asks the data source of the variable
`datasource`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isinf
from typing import Final

from grafana_foundation_sdk.builders import common as common_builders
from grafana_foundation_sdk.builders import dashboard as builders
from grafana_foundation_sdk.builders import prometheus, stat, statetimeline, table, timeseries
from grafana_foundation_sdk.models import common, dashboard
from grafana_foundation_sdk.models.prometheus import PromQueryFormat

__all__ = [
    "DRIVE_LINK",
    "GREY",
    "LINE_LINK",
    "RED",
    "SOURCE",
    "YELLOW",
    "Column",
    "Limits",
    "chart",
    "columns",
    "figure",
    "states",
]

GREY: Final = "#8e8e8e"
YELLOW: Final = "semi-dark-yellow"
RED: Final = "semi-dark-red"
SOURCE: Final = dashboard.DataSourceRef(type_val="prometheus", uid="${datasource}")
DRIVE_LINK: Final = (
    "/d/lecombus-drive?var-datasource=${datasource}"
    "&var-line=${__data.fields.line}&var-drive=${__data.fields.drive}"
)
LINE_LINK: Final = "/d/lecombus-line?var-datasource=${datasource}&var-line=${__data.fields.line}"

Limits = Mapping[float, str]
"""From which value on which colour holds; below the first (which may be -inf) it is grey."""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Args:
        title: Its heading.
        query: What it shows, one row for each set of the labels kept.
        unit: Grafana's name of its unit.
        limits: From which value on which colour holds.
        words: Words for values, with a colour.
    """

    title: str
    query: str
    unit: str = "short"
    limits: Limits | None = None
    words: Mapping[int, tuple[str, str]] | None = None


def figure(
    title: str,
    query: str,
    about: str,
    *,
    unit: str = "short",
    limits: Limits | None = None,
    words: Mapping[int, tuple[str, str]] | None = None,
    width: int = 4,
) -> stat.Panel:
    """Return one large number or word, such as the number of drives that need somebody."""
    panel = (
        stat.Panel().title(title).description(about).datasource(SOURCE)
        .height(4).span(width).unit(unit)
        .color_mode(common.BigValueColorMode.VALUE).graph_mode(common.BigValueGraphMode.NONE)
        .reduce_options(common_builders.ReduceDataOptions().calcs(["lastNotNull"]))
        .thresholds(steps(limits)).color_scheme(by_limits())
        .with_target(question(query).instant().ref_id("A"))
    )  # fmt: skip
    return panel.mappings([words_of(words)]) if words else panel


def chart(
    title: str,
    queries: Mapping[str, str],
    about: str,
    *,
    unit: str = "short",
    limits: Limits | None = None,
    width: int = 12,
) -> timeseries.Panel:
    """Return curves over time, in shades of grey; limits are shown as coloured areas.

    Args:
        title: Its heading.
        queries: What it shows, by the text of the legend.
        about: What it means, and what to look for.
        unit: Grafana's name of the unit.
        limits: From which value on the background is coloured.
        width: 24 is all.
    """
    style = common.GraphThresholdsStyleMode.AREA if limits else common.GraphThresholdsStyleMode.OFF
    panel = (
        timeseries.Panel().title(title).description(about).datasource(SOURCE)
        .height(8).span(width).unit(unit).min(0)
        .line_width(1).fill_opacity(0).show_points(common.VisibilityMode.NEVER)
        .thresholds(steps(limits, base="transparent"))
        .thresholds_style(common_builders.GraphThresholdsStyleConfig().mode(style))
        .color_scheme(
            builders.FieldColor().mode(dashboard.FieldColorModeId.SHADES).fixed_color(GREY)
        )
        .legend(
            common_builders.VizLegendOptions().display_mode(common.LegendDisplayMode.LIST)
            .placement(common.LegendPlacement.BOTTOM).show_legend(True)
        )
    )  # fmt: skip
    for number, (legend, query) in enumerate(queries.items()):
        panel.with_target(question(query).legend_format(legend).range().ref_id(ref_id(number)))
    return panel


def states(
    title: str,
    query: str,
    legend: str,
    about: str,
    words: Mapping[int, tuple[str, str]],
    *,
    width: int = 24,
    height: int = 8,
) -> statetimeline.Panel:
    """Return a row over time for each series, coloured where its state is not normal."""
    return (
        statetimeline.Panel().title(title).description(about).datasource(SOURCE)
        .height(height).span(width).mappings([words_of(words)])
        .show_value(common.VisibilityMode.NEVER).row_height(0.8).fill_opacity(70).line_width(0)
        .thresholds(steps(None)).color_scheme(by_limits())
        .with_target(question(query).legend_format(legend).range().ref_id("A"))
    )  # fmt: skip


def columns(
    title: str,
    about: str,
    of: Sequence[Column],
    labels: Sequence[str],
    *,
    worst: str,
    greatest_first: bool = True,
    link: str = "",
    width: int = 24,
    height: int = 9,
) -> table.Panel:
    """Return a table with a row for each set of labels, worst first.

    Args:
        title: Its heading.
        about: What it means.
        of: Its columns; each query has one value for each row.
        labels: The labels that make a row, the first columns.
        worst: The heading of the column by which it is sorted.
        greatest_first: Whether the greatest of it is the worst.
        link: Where a click on the last of the labels leads.
        width: 24 is all.
        height: In units of the grid.
    """
    panel = (
        table.Panel().title(title).description(about).datasource(SOURCE)
        .height(height).span(width).thresholds(steps(None)).color_scheme(by_limits())
        .sort_by([common_builders.TableSortByFieldState().display_name(worst)
                  .desc(greatest_first)])
    )  # fmt: skip
    names = {}
    for number, column in enumerate(of):
        ref = ref_id(number)
        names[f"Value #{ref}" if len(of) > 1 else "Value"] = column.title
        kept = f"max by ({', '.join(labels)}) ({column.query})"
        panel.with_target(
            question(kept).instant().format(PromQueryFormat.TABLE).ref_id(ref)
        )  # fmt: skip
        panel.override_by_name(column.title, column_look(column))
    if len(of) > 1:
        panel.with_transformation(dashboard.DataTransformerConfig(id_val="merge", options={}))
    order = {name: number for number, name in enumerate([*labels, *names])}
    panel.with_transformation(
        dashboard.DataTransformerConfig(
            id_val="organize",
            options={"excludeByName": {"Time": True}, "indexByName": order, "renameByName": names},
        )
    )
    if link:
        links = [{"title": "Open", "url": link}]
        panel.override_by_name(labels[-1], [dashboard.DynamicConfigValue("links", links)])
    return panel


def column_look(column: Column) -> list[dashboard.DynamicConfigValue]:
    """Return what makes a column's values look as they should."""
    look: list[dashboard.DynamicConfigValue] = [dashboard.DynamicConfigValue("unit", column.unit)]
    if column.limits:
        look.append(dashboard.DynamicConfigValue("thresholds", steps(column.limits).build()))
    if column.words:
        look.append(dashboard.DynamicConfigValue("mappings", [words_of(column.words)]))
    if column.limits or column.words:
        cell = {"type": "color-text"}
        look.append(dashboard.DynamicConfigValue("custom.cellOptions", cell))
    return look


def question(query: str) -> prometheus.Dataquery:
    """Return a query of Prometheus."""
    return prometheus.Dataquery().expr(query).datasource(SOURCE)


def ref_id(number: int) -> str:
    """Return the name of a query within its panel."""
    return chr(ord("A") + number)


def steps(limits: Limits | None, *, base: str = GREY) -> builders.ThresholdsConfig:
    """Return thresholds: `base`, which is normal, below the first limit."""
    found = [
        dashboard.Threshold(value=None if isinf(value) else value, color=one)
        for value, one in {-inf: base, **(limits or {})}.items()
    ]
    return builders.ThresholdsConfig().mode(dashboard.ThresholdsMode.ABSOLUTE).steps(found)


def by_limits() -> builders.FieldColor:
    """Return that values have the colour of their threshold."""
    return builders.FieldColor().mode(dashboard.FieldColorModeId.THRESHOLDS)


def words_of(words: Mapping[int, tuple[str, str]]) -> dashboard.ValueMap:
    """Return words and colours for values."""
    return dashboard.ValueMap(
        {
            str(value): dashboard.ValueMappingResult(text=text, color=one, index=number)
            for number, (value, (text, one)) in enumerate(words.items())
        }
    )
