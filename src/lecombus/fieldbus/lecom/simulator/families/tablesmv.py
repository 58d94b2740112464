"""The codes and fault numbers of the SMVector, as its LECOM manual lists them.

Strategy: parameter Pnnn is code 1000 + nnn. The manual names VH for C0068, C0135 and C0150 and VS
for C0200 and C0201; all else is a decimal number. It mentions further parameters without their
limits (P100, P103, ..): these have what such a drive commonly has.

Source: CMVLC401A 4.1, 4.2, 7.2, 8.1 (table 9), 9.1..9.4.
"""

from __future__ import annotations

from typing import Final

from lecombus.fieldbus.lecom.simulator.parameters import Kept, Spec, d, h, s
from lecombus.fieldbus.lecom.simulator.troubles import kinds

__all__ = ["FAULTS_SMV", "LECOM_NUMBERS", "SPECS_SMV"]

_NET: Final = Kept.PROCESS

SPECS_SMV: Final[tuple[Spec, ...]] = (
    d(37, "20", (0, 500), decimals=1),
    d(38, "30", (0, 500), decimals=1),
    d(39, "40", (0, 500), decimals=1),
    d(40, "0", (0, 1), kept=_NET),
    d(43, "0", (0, 1), kept=_NET),
    d(46, "0"),
    d(50, "0"),
    h(68, "H0000"),
    h(135, "H0000", writable=True),
    d(140, "0", (0, 500), decimals=1, kept=_NET),
    h(150, "H0000"),
    s(200, "33SSSMD-M_14000"),
    s(201, "2008-10-18"),
    d(248, "0", (0, 255), kept=_NET),
    d(249, "0", (0, 7), kept=_NET),
    d(1050, "0", (0, 1536), kept=_NET),
    d(1055, "0", (0, 100), decimals=1, kept=_NET),
    d(1060, "20", (0, 500), decimals=1, kept=_NET),
    d(1061, "0", (0, 500), decimals=1, kept=_NET),
    *(d(number, "0") for number in range(1070, 1075)),
    d(1080, "100", (0, 400), decimals=1, kept=_NET),
    d(1081, "0", (0, 400), decimals=1, kept=_NET),
    d(1099, "4.1"),
    d(1100, "0", (0, 6)),
    d(1101, "0", (0, 6)),
    d(1102, "0", (0, 500), decimals=1),
    d(1103, "60", ("7.5", 500), decimals=1),
    d(1104, "20", (0, 3600), decimals=1),
    d(1105, "20", (0, 3600), decimals=1),
    d(1111, "0", (0, 3)),
    d(1112, "0", (0, 1)),
    *(d(number, "0", (0, 25)) for number in range(1121, 1125)),
    d(1131, "20", (0, 500), decimals=1),
    d(1140, "0", (0, 25)),
    d(1142, "0", (0, 25)),
    d(1150, "0", (0, 9)),
    d(1194, "0"),
    d(1400, "0", (0, 7)),
    d(1401, "1.2"),
    d(1402, "0"),
    d(1403, "0", (0, 1), kept=_NET),
    d(1404, "3", (0, 3)),
    d(1405, "0"),
    d(1406, "0"),
    d(1410, "1", (1, 99)),
    d(1411, "0", (0, 4)),
    d(1420, "0", (0, 4)),
    d(1424, "0", (0, 1)),
    d(1425, "50", (0, 65000)),
    d(1426, "0", (0, 3)),
    d(1427, "0"),
    d(1494, "1.20"),
    d(1495, "0"),
    d(1498, "0"),
    d(1499, "0"),
    *(d(1500, "0", subcode=n) for n in range(9)),
    d(1501, "410"),
    d(1502, "25"),
    d(1505, "320"),
    d(1506, "230"),
    d(1507, "40"),
    d(1508, "0"),
    d(1527, "0"),
    d(1530, "0"),
    d(1531, "0"),
    d(1540, "1204"),
    d(1541, "5321"),
)

FAULTS_SMV: Final = kinds(trips=tuple(range(1, 37)))
"""Numbers of P500. Source: CMVLC401A 9.1."""

LECOM_NUMBERS: Final = {
    2: 11, 3: 12, 4: 50, 6: 1020, 7: 1030, 8: 16, 13: 91, 14: 72, 34: 61, 36: 61,
}  # fmt: skip
"""What P500's faults would be as LECOM fault numbers: short circuit, earth fault, overheating,
overvoltage, undervoltage, motor overload, external fault, memory, communication; no others.

Only 50 stands in the drive's own manual (CMVLC401A table 9, C0068), the rest are like faults of
EDB2102EN 8.2.
"""
