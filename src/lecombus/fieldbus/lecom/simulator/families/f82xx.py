"""The 82XX families: 820X with its peculiarities, 821X, 822X, 824X and the 8200 vector.

Source: EDB2102EN 3.4, 6.1, 6.3, 6.4, 6.5, 8.2.
"""

from __future__ import annotations

from typing import ClassVar

from lecombus.fieldbus.lecom.simulator.families.inverter82xx import Drive82XX
from lecombus.fieldbus.lecom.simulator.families.table2102 import SPECS_82XX
from lecombus.fieldbus.lecom.simulator.model import INHIBIT, Restart
from lecombus.fieldbus.lecom.simulator.parameters import Kept, Spec, d, s

__all__ = ["Drive820X", "Drive821X", "Drive822X", "Drive824X", "Vector8200"]

_FREE_820X = frozenset((40, 46, 135, 141, 248, 249, 1920, 1921, 1922, 1923))


class Drive820X(Drive82XX):
    """An 820X: slow, keeps parameters only while inhibited, restarts on a TRIP reset."""

    family: ClassVar[str] = "820x"
    shortened_s: ClassVar[float] = 0.230

    def __init__(self) -> None:
        # C0120 is not available in V1.2, and C0181 comes with it. Source: EDB2102EN 6.4.1, 6.4.2.
        specs = (spec for spec in SPECS_82XX if spec.number not in (43, 120, 127, 141))
        own = (
            d(141, "0", (0, 100), decimals=2, kept=Kept.PROCESS),
            d(181, "0", (0, 80), kept=Kept.MODULE),
            s(200, "33S8201E_12000"),
        )
        super().__init__((*specs, *own))

    def _install(self) -> None:
        super()._install()
        del self.readers[43], self.writers[43]
        self.writers[141] = self._take_relative

    def _take_relative(self, text: str) -> None:
        """C0141 in % of C0011 of set 1 becomes the setpoint. Source: EDB2102EN 6.4.1."""
        hertz = float(text) / 100.0 * self.params.number(11)
        self.params.set(46, self.frequency_text(hertz, 2))

    def normalized(self) -> bool:
        """There is no C0127 here: C0141 and C0046 stand side by side."""
        return False

    def ramp_generator(self) -> bool:
        """Bits 4 and 5 of C0135 are reserved."""
        return False

    def think_s(self, number: int, *, write: bool, now_s: float) -> float:
        """Source: EDB2102EN 3.4, note 1 for C0001 = 1."""
        if 1920 <= number <= 1923:
            return 0.500
        if number == 46 and write and self.params.text(1) == "1":
            return 0.070
        if number in (46, 50, 135, 150):
            return 0.035
        if number == 68:
            return 0.070
        return 0.230 if write else 0.055

    def stores(self, spec: Spec) -> bool:
        """Parameters are acknowledged while enabled, but not saved. Source: EDB2102EN 6.4."""
        return spec.number in _FREE_820X or self.inhibited()

    def take_inhibit(self, text: str) -> None:
        """C0040; inhibit followed by enable resets a TRIP by a restart. Source: EDB2102EN 6.4."""
        before = self.control
        super().take_inhibit(text)
        self._restart_on_enable(before)

    def take_control_word(self, text: str) -> None:
        """C0135; bit 11 is reserved on an 820X."""
        before, self.control = self.control, int(text[1:], 16)
        self._restart_on_enable(before)

    def _restart_on_enable(self, before: int) -> None:
        if self.fault and before & INHIBIT and not self.control & INHIBIT:
            raise Restart

    def controller_state(self) -> int:
        """Bits 8..11: 0 no error, 1 error."""
        return 1 if self.fault else 0

    def status_word(self) -> int:
        """C0150 of an 820X: bits 0 and 3 are reserved. Source: EDB2102EN 8.2."""
        return super().status_word() & ~0x0009


class Drive821X(Drive82XX):
    """An 821X."""

    family: ClassVar[str] = "821x"
    software: ClassVar[str] = "33S8211E_20000"

    def __init__(self) -> None:
        super().__init__((*SPECS_82XX, s(200, self.software)))


class Drive822X(Drive821X):
    """An 822X."""

    family: ClassVar[str] = "822x"
    software: ClassVar[str] = "33S8221E_11000"


class Drive824X(Drive821X):
    """An 824X."""

    family: ClassVar[str] = "824x"
    software: ClassVar[str] = "33S8241E_10000"


class Vector8200(Drive82XX):
    """An 8200 vector: four parameter sets, arrays, a freely configured status word."""

    family: ClassVar[str] = "8200vector"
    set_count: ClassVar[int] = 4

    def __init__(self) -> None:
        arrays = (
            *(d(39, "40", (0, 650), subcode=n, decimals=2, sets=True) for n in range(1, 4)),
            *(d(357, "3000", (0, 65000), subcode=n) for n in range(1, 4)),
            d(370, "0", (0, 255)),
            d(599, "5", (1, 50)),
            *(d(410, "255", (0, 255), subcode=n) for n in range(1, 33)),
            *(d(412, "255", (0, 255), subcode=n) for n in range(1, 10)),
            *(d(417, "0", (0, 255), subcode=n) for n in range(1, 17)),
            *(d(421, "0", (0, 255), subcode=n) for n in range(1, 11)),
        )
        # C0127 and the setpoint C0141 are of the 821X, 822X and 824X. Source: EDB2102EN 6.5.
        specs = (spec for spec in SPECS_82XX if spec.number not in (127, 141))
        super().__init__((*specs, *arrays, s(200, "82S8212V_30000")))

    def normalized(self) -> bool:
        """There is no C0127: the setpoint is C0046."""
        return False

    def shown_message(self) -> bool:
        """Bit 13 of C0150: any message."""
        return bool(self.troubles.message)

    def shown_warning(self) -> bool:
        """Bit 12 of C0150: any warning."""
        return bool(self.troubles.warning)

    def operating_status(self) -> int:
        """C0068: bits 10 and 12 are reserved. Source: EDB2102EN 8.2."""
        return super().operating_status() & ~0x1400
