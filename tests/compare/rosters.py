"""The rosters of the command part: right ones, and wrong ones with one kind of mistake each.

Each is an edit of `GOOD`: what is replaced and by what; rows that begin with `line`, `drive` or
`top` are put into that section.
"""

from __future__ import annotations

from config.rosters import GOOD

PORT = "/dev/serial/by-id/usb-1"
ADDRESSES = [number for number in range(1, 100) if number % 10]

Edit = tuple[str, str] | str | bytes
"""Old and new text; or keys of a section, such as `line baud: 1`; or the whole file."""


def written(edit: Edit) -> bytes:
    """Return the file of an edit."""
    if isinstance(edit, bytes):
        return edit
    if isinstance(edit, tuple):
        old, new = edit
        assert old in GOOD, old
        return GOOD.replace(old, new).encode()
    section, _, keys = edit.partition(" ")
    places = {"line": ("drives:", f"  {keys}\ndrives:"), "top": ("", "")}
    if section == "line":
        return GOOD.replace(*places["line"]).encode()
    if section == "drive":
        return GOOD.replace(
            "    family: 8200vector\n", f"    family: 8200vector\n    {keys}\n"
        ).encode()
    assert section == "top", section
    return f"{GOOD}{keys}\n".encode()


def many(count: int, family: str, more: str = "", line: str = "") -> bytes:
    """Return a roster of so many drives of a family."""
    entries = "".join(
        f"  - {{name: d{n}, address: {n}, family: {family}{more}}}\n" for n in ADDRESSES[:count]
    )
    return f"line: {{name: l, port: 'sim:', baud: 19200{line}}}\ndrives:\n{entries}".encode()


_GUARD = ", watchdog: {time: 2s, action: quick-stop, configure: true}"

RIGHT: dict[str, Edit] = {
    "good": ("", ""),
    **{f"full-{family}": many(31, family, _GUARD)
       for family in ("820x", "821x", "822x", "824x", "8200vector", "93xx", "smvector")},
    "generic": many(31, "generic", ", cyclic: [{code: C0038, every: 1s}]"),
    "ninety": many(90, "8200vector", "", ", repeaters: true"),
    "too-fast": many(31, "8200vector", ", cyclic: [{code: C0150, every: 50ms}]"),
    "short-watchdogs": many(31, "smvector", ", watchdog: {time: 200ms, action: trip}"),
    "slow": many(10, "820x", ", watchdog: {time: 10s, action: inhibit}").replace(b"19200", b"1200"),
    "no-configure": many(3, "93xx", ", watchdog: {time: 1s, action: inhibit}"),
    "tcp": many(3, "93xx").replace(b"sim:", b"socket://192.0.2.7:4001"),
    "multicast": "top groups: {g: {members: [feeder, belt], multicast: true}}",
    "on-shutdown": "top on_shutdown: quick-stop",
    "mqtt": "top mqtt: {host: broker}",
    "modbus": "top modbus: {}",
    "notify": "top notify: {command: [/usr/local/bin/page]}",
    "version": "top version: 1",
    "no-cyclic": "drive cyclic: []",
    "slow-drive": "drive answer_time: 300ms",
    "standard": "drive addressing: standard",
    "fallback": "drive stop_fallback: none",
    "identity": "drive identity: {C0200: x}",
    "fibre": "line medium: fibre",
    "tolerate": "line tolerate: 3",
}  # fmt: skip

_WRONG: tuple[Edit, ...] = (
    b"", b"x", b"- x",
    b"{", b"line: [", b"\xff\xfe", b"\t- x", b"line: *a", b"a: &a [*a]", b"line:\n line: {}",
    b"line: {}\ndrives: [{}]\n", b"lease: {}\n", b"---\n---\n",
    "line baud: 9601", "line baud: fast", "line baud: [9600]", "line baud:", "line medium: rs458",
    "line direction: auto", "line echo: maybe", "line parity: even", "line repeaters: 1",
    "line turnaround: 2", "line turnaround: 2s", "line turnaround: -2ms", "line retries: 11",
    "line retries: 2.0", "line late_answer: 1min", "line adapter_latency: 16",
    "line absent_share: 0.1",
    "line absent_share: 80%", "line stall: 10ms", "line bauds: 9600", "line colour: red",
    "line tolerate: 4",
    "line name: again", "line medium: rs232", "line medium: fibre\n  repeaters: true",
    (PORT, "''"), (PORT, "sockt://h:1"), (PORT, "http://h:1"), (PORT, "socket://host"),
    (PORT, "socket:host:1"), (PORT, "socket://h:70000"), (PORT, "socket://h:0"), (PORT, "ttyUSB0"),
    (PORT, "simm"), (PORT, "/dev/serial/"), (PORT, "rfc2217://server:4002"),
    (PORT, "socket://h:1\n  direction: rts"),
    ("hall-3", "hall 3"), ("hall-3", "../etc"), ("hall-3", "Ä"), ("hall-3", "x" * 65),
    ("hall-3", "''"),
    ("12", "10"), ("12", "0"), ("12", "100"), ("12", "-1"), ("12", "013"), ("12", "11:30"),
    ("12", "0x0B"),
    ("12", "1_1"), ("12", "eleven"), ("12", "11"), ("12", "9" * 5000),
    ("belt", "feeder"), ("belt", "all"), ("belt", "Belt 2"), ("belt", "-"), ("belt", "[a]"),
    ("smvector", "8200vektor"), ("smvector", "siemens"),
    many(32, "generic"), many(53, "generic", "", ", medium: fibre"),
    many(91, "generic", "", ", repeaters: true"),
    "drive watchdog: {time: 2, action: trip}", "drive watchdog: {time: 66s, action: none}",
    "drive watchdog: {time: 49ms, action: none}", "drive watchdog: {time: 50.5ms, action: none}",
    "drive watchdog: {time: 2s, action: trip}", "drive watchdog: {time: 2s, action: quickstop}",
    "drive watchdog: {time: 2s}", "drive watchdog: {action: none, config: true}",
    "drive watchdog: 2s",
    "drive writable: [C99999]", "drive writable: [C0039/256]", "drive writable: [P1000]",
    "drive writable: [C12x]", "drive cyclic: [{code: 1, every: 0s}]",
    "drive cyclic: [{code: 1, every: 5ms}]",
    "drive cyclic: [{code: C46, every: 1s}, {code: 46, every: 2s}]", "drive cyclic: C0150",
    "drive cyclic: [C0150]", "drive cyclic: {code: C1, every: 1s}", "drive writable: C0046",
    "drive writable: [C46, C0046]", "drive also_writable: [C0009]",
    "drive also_writable: [C46, C0046]",
    "drive writable: [C39/1]\n    addressing: standard", "drive addressing: extended",
    "drive answer_time: 0s", "drive adress: 12", "drive lease: {on_lapse: stop}",
    "drive restore: maybe",
    "drive stop_fallback: coast", "drive identity: [x]", "drive stored_writes: {burst: 0}",
    "drive accept_software: [1.20]", "drive unchecked: [C9999]",
    "top groups: {g: {members: [bel]}}", "top groups: {g: {members: [xyz]}}",
    "top groups: {g: {members: []}}",
    "top groups: {g: {members: [belt, belt]}}", "top groups: {g: {}}",
    "top groups: {belt: {members: [belt]}}",
    "top groups: {all: {members: [belt]}}", "top groups: {g: {members: [belt], multicast: 1}}",
    "top groups: {A: {members: [belt]}}", "top groups: [belt]", "top groups: {g: [belt]}",
    "top on_shutdown: stop", "top api: {http: 0.0.0.0:9740}", "top api: {http: 9740}",
    "top api: {http: 'localhost:99999'}", "top api: {socket: run/x.sock}",
    "top api: {tokens: /etc/}",
    f"top api: {{socket: /{'x' * 200}}}", "top mqtt: {port: 1}", "top mqtt: {host: 'a:1'}",
    "top journal: x.sqlite", "top lease: yes", "top lease: {time: 1ms}", "top on-shutdown: nothing",
    "top line: {}", "top state: x", "top apis: {}",
    "top lease: {required: true, on_lapse: inhibit, x: 1}",
    "drive cyclic: [{code: C0094, every: 10s}]", "top modbus: {port: 0}", "top modbus: {listen: x}",
    "top modbus: {control: 1}", "top notify: {}", "top notify: {command: page}",
    "top notify: {mail: {to: x}}", "top mqtt: {host: broker, security: no}", "top version: 99",
)  # fmt: skip

WRONG: dict[str, Edit] = {f"{number:03d}": edit for number, edit in enumerate(_WRONG)}
