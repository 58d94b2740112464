"""The codes and fault numbers of drives behind a 2102 module, as its manual lists them.

Strategy: `default` is the setting the maker ships. Where the manual prints none, and for the
controllers' own codes that it only mentions, the value is what such a drive commonly shows.

Source: EDB2102EN 3.4, 5, 6, 8.2.
"""

from __future__ import annotations

from typing import Final

from lecombus.fieldbus.lecom.simulator.parameters import Kept, Spec, d, h, s
from lecombus.fieldbus.lecom.simulator.troubles import kinds

__all__ = ["FAULTS_82XX", "FAULTS_93XX", "MODULE_SPECS", "SPECS_82XX", "SPECS_93XX"]

MODULE_SPECS: Final[tuple[Spec, ...]] = (
    d(248, "0", (0, 255), kept=Kept.MODULE),
    d(249, "0", (0, 15), kept=Kept.MODULE),
    s(1810, "33S2102I_10000"),
    s(1811, "2000-05-02"),
    d(1920, "0", (0, 1), kept=Kept.MODULE),
    d(1921, "0", (0, 1), kept=Kept.MODULE),
    d(1922, "0", (0, 2), kept=Kept.MODULE),
    d(1923, "3000", (50, 65535), kept=Kept.MODULE),
    d(1962, "0"),
)
"""The module's own codes. The manual prints no default for C1923; 3000 ms stands in."""

SPECS_82XX: Final[tuple[Spec, ...]] = (
    *MODULE_SPECS,
    d(1, "0", (0, 3), sets=True),
    d(2, "0", (0, 5)),
    d(4, "50", (0, 255)),
    d(9, "1", (1, 99)),
    d(10, "0", (0, 480), decimals=2, sets=True),
    d(11, "50", ("7.5", 480), decimals=2, sets=True),
    d(12, "5", (0, 1300), decimals=2, sets=True),
    d(13, "5", (0, 1300), decimals=2, sets=True),
    d(14, "2", (0, 4), sets=True),
    d(15, "50", ("7.5", 960), decimals=2, sets=True),
    d(16, "3", (0, 40), decimals=2, sets=True),
    d(17, "0", (0, 480), decimals=2, sets=True),
    d(18, "1", (0, 6), sets=True),
    d(19, "0", (0, 5), decimals=2, sets=True),
    d(21, "0", (0, 50), decimals=1, sets=True),
    d(22, "150", (30, 150), sets=True),
    d(23, "80", (30, 110), sets=True),
    d(37, "20", (0, 480), decimals=2, sets=True),
    d(38, "30", (0, 480), decimals=2, sets=True),
    d(39, "40", (0, 480), decimals=2, sets=True),
    d(40, "0", (0, 1), kept=Kept.PROCESS),
    d(43, "0", (0, 0), kept=Kept.PROCESS),
    d(46, "0", (0, 480), decimals=2, kept=Kept.PROCESS),
    d(50, "0"),
    d(52, "0"),
    d(53, "320"),
    d(54, "0"),
    d(56, "0"),
    d(61, "34"),
    h(68, "H0000"),
    d(93, "222"),
    d(99, "21"),
    d(105, "5", (0, 1300), decimals=2, sets=True),
    d(120, "0", (0, 100)),
    d(125, "0", (0, 4)),
    d(127, "0", (0, 1)),
    h(135, "H0000", writable=True),
    d(141, "0", (-100, 100), decimals=2, kept=Kept.PROCESS),
    h(150, "H0000"),
    d(161, "0"),
    d(162, "0"),
    d(163, "0"),
    d(164, "0"),
    d(178, "1234"),
    d(179, "5678"),
    s(201, "1999-03-17"),
    d(500, "2000", (1, 25000)),
    d(501, "10", (1, 25000)),
)

SPECS_93XX: Final[tuple[Spec, ...]] = (
    *MODULE_SPECS,
    d(3, "0", (0, 4), kept=Kept.PROCESS),
    d(5, "1001", (0, 72000), kept=Kept.MEMORY),
    d(9, "1", (1, 99)),
    d(11, "3000", (500, 16000), kept=Kept.MEMORY),
    d(12, "2", (0, 9999), decimals=3, kept=Kept.MEMORY),
    d(13, "2", (0, 9999), decimals=3, kept=Kept.MEMORY),
    *(d(39, "10", (-200, 200), subcode=n, decimals=2, kept=Kept.MEMORY) for n in range(1, 16)),
    d(40, "0", (0, 1), kept=Kept.PROCESS),
    d(43, "0", (0, 0), kept=Kept.PROCESS),
    d(46, "0"),
    d(50, "0"),
    d(51, "0"),
    d(52, "0"),
    d(53, "540"),
    d(54, "0"),
    d(61, "38"),
    *(d(67, "0", subcode=n) for n in range(9)),
    h(68, "H0000"),
    d(93, "9321"),
    d(99, "20"),
    *(d(102, "2", (0, 9999), subcode=n, decimals=3, kept=Kept.MEMORY) for n in range(1, 4)),
    *(d(103, "2", (0, 9999), subcode=n, decimals=3, kept=Kept.MEMORY) for n in range(1, 4)),
    d(105, "2", (0, 9999), decimals=3, kept=Kept.MEMORY),
    d(125, "0", (0, 4)),
    h(135, "H0000", writable=True),
    d(141, "0", (-200, 200), decimals=2, kept=Kept.PROCESS),
    h(150, "H0000"),
    *(d(161, "0", subcode=n) for n in range(9)),
    *(d(168, "0", subcode=n) for n in range(9)),
    d(178, "1234"),
    d(179, "5678"),
    s(200, "33S9300I_20000"),
    s(201, "Mar 17 1999 10:31"),
)

FAULTS_82XX: Final = kinds(
    trips=(
        *(11, 12, 13, 14, 15, 16, 32, 50, 53, 61, 62, 63, 64, 65, 66, 71, 72, 73, 75, 76, 77, 78),
        *(81, 85, 91, 105, 140),
    ),
    messages=(1020, 1030),
    warnings=(203,),
)
"""LECOM fault numbers of C0161..C0164. Source: EDB2102EN 8.2."""

FAULTS_93XX: Final = kinds(
    trips=(
        *(11, 12, 15, 50, 53, 58, 61, 62, 63, 64, 70, 71, 72, 73, 74, 75, 77, 78, 79, 82, 83, 86),
        *(91, 105, 107, 110, 111, 153, 163, 200),
    ),
    messages=(1020, 1030, 1091),
    warnings=(2054, 2057, 2058, 2061, 2062, 2063, 2064, 2082, 2083, 2086, 2091, 2153),
)
"""LECOM fault numbers of C0168. Source: EDB2102EN 8.2."""
