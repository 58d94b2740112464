"""The roster as the program uses it: frozen, complete, in seconds and codes.

All defaults are filled in, also those that follow from a drive's family; durations are seconds
(`*_s`), shares are fractions. A `Roster` needs no further check. Models are made by `config`, from
values that were read and checked; pydantic checks the types.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Literal, get_args

from pydantic import BaseModel, ConfigDict

from lecombus.drives.family import ANSWER_FACTOR
from lecombus.drives.measured import SlowAnswers
from lecombus.parameters import AddressForm, Code

__all__ = [
    "ON_DEMAND_GOOD_S",
    "Addressing",
    "ApiEntry",
    "CyclicEntry",
    "Direction",
    "DriveEntry",
    "Echo",
    "GroupEntry",
    "HttpAddress",
    "JournalEntry",
    "Lapse",
    "LeaseEntry",
    "LineEntry",
    "MailEntry",
    "MailSecurity",
    "Medium",
    "MessageLimit",
    "ModbusEntry",
    "MqttEntry",
    "NotifyEntry",
    "NotifyEvent",
    "OnJournalFailure",
    "OnShutdown",
    "Parity",
    "Roster",
    "StopFallback",
    "StoredWrites",
    "TlsEntry",
    "WatchdogEntry",
    "good_for_s",
    "group_entry",
    "is_loopback",
    "is_network_port",
    "with_address",
]

Medium = Literal["rs485", "rs232", "fibre"]
Direction = Literal["adapter", "kernel", "rts"]
Echo = Literal["auto", "yes", "no"]
Parity = Literal["line", "port"]
Addressing = Literal["both", "standard"]
Lapse = Literal["quick-stop", "inhibit", "silence", "hold"]
StopFallback = Literal["inhibit", "none"]
OnShutdown = Literal["nothing", "quick-stop", "inhibit"]
OnJournalFailure = Literal["refuse", "go-on"]
MailSecurity = Literal["starttls", "tls", "none"]
NotifyEvent = Literal[
    "trip", "drive-lost", "line-lost", "watchdog-missed", "lease-lapse", "daemon-lost"
]
"""What `lecombus bridge notify` sends messages of."""


MulticastAddress = Callable[[frozenset[int], frozenset[int]], int | None]
"""Gives the address that reaches exactly some of a line's drives, by their addresses and all."""


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class LineEntry(_Model):
    """The line.

    Args:
        name: Its name: metrics label, socket and file names.
        port: Device path, `socket://HOST:PORT` or `sim:`.
        baud: Bits a second, one of those that the protocol knows.
        medium: What the drives hang on; bounds their number.
        repeaters: An RS-485 line with repeaters: 90 drives instead of 31.
        direction: Who switches the RS-485 transceiver.
        echo: Whether what is sent comes back; `auto` finds out.
        parity: Who makes even parity: we in bit 7 (`line`) or a device server (`port`).
        turnaround_s: Least pause between an answer's end and the next telegram.
        retries: Repetitions after a failed exchange, 0 to 10.
        tolerate: Lost answers within any watchdog time that no watchdog may act upon, 0 to 3.
        adapter_latency_s: What the adapter adds to an answer; None: by the kind of port.
        late_answer_s: How late an answer may still come after a time-out.
        absent_share: Largest share of line time for probing absent drives, 0.01 to 0.5.
        stall_s: Silence of all drives after which the port is reopened; 0: never.
        protocol: What the drives speak.
    """

    name: str
    port: str
    baud: int = 9600
    medium: Medium = "rs485"
    repeaters: bool = False
    direction: Direction = "adapter"
    echo: Echo = "auto"
    parity: Parity = "line"
    turnaround_s: float = 0.002
    retries: int = 2
    tolerate: int = 1
    adapter_latency_s: float | None = None
    late_answer_s: float = 0.5
    absent_share: float = 0.10
    stall_s: float = 30.0
    protocol: str = "lecom"


class WatchdogEntry(_Model):
    """What a drive's watchdog shall be.

    Args:
        time_s: Its monitoring time.
        action: The family's word for what it does (`WatchdogTraits.actions`).
        configure: Whether lecombus writes it into the drive; otherwise it only compares.
    """

    time_s: float
    action: str
    configure: bool = False


class CyclicEntry(_Model):
    """A code read again and again."""

    code: Code
    every_s: float


class LeaseEntry(_Model):
    """Whether control of a drive needs a lease, and what its lapse does."""

    required: bool = False
    time_s: float = 2.0
    on_lapse: Lapse = "quick-stop"


class StoredWrites(_Model):
    """How often codes that wear a drive's memory may be written.

    Args:
        burst: Writes of one code that may follow each other.
        every_s: Seconds until one more may follow; 0: no limit.
    """

    burst: int = 30
    every_s: float = 600.0


OF_USE: Final = (
    "cyclic", "writable", "unchecked", "restore", "allow_address_change", "stored_writes", "lease",
    "stop_fallback",
)  # fmt: skip
"""The keys of a drive that may change without an audit."""


class DriveEntry(_Model):
    """One drive.

    Args:
        name: Its name.
        address: 1..99 without those ending in 0.
        family: The name of its family.
        forms: The addressing forms used with it, the cheaper first.
        watchdog: What its watchdog shall be; None: not looked after.
        cyclic: What is read all the time; the family's status set unless the roster says.
        writable: What may be written: the roster's `writable`, else the family's set, and
            `also_writable`; without `owned`.
        owned: What lecombus itself sets from the roster, so that no client writes it: the codes of
            its watchdog, where the roster says `configure`.
        unchecked: What is written without asking whether its manual allows the value.
        restore: Whether a backup may be restored into it, beyond what `writable` lists.
        answer_time_s: Its processing time where it differs from its family's; None: the family's.
        accept_software: Software identifications accepted besides those of the manual.
        allow_address_change: Whether its address may be changed by the command for that.
        identity: What identity codes must read, by code.
        stored_writes: How often stored codes may be written.
        lease: Whether its control needs a lease.
        stop_fallback: What is sent when a quick stop is impossible: inhibit or none.
        slow: What a running line measured of it; no roster says that.
    """

    name: str
    address: int
    family: str
    forms: tuple[AddressForm, ...]
    watchdog: WatchdogEntry | None = None
    cyclic: tuple[CyclicEntry, ...]
    writable: frozenset[Code]
    owned: frozenset[Code] = frozenset()
    unchecked: frozenset[Code] = frozenset()
    restore: bool = False
    answer_time_s: float | None = None
    accept_software: tuple[str, ...] = ()
    allow_address_change: bool = False
    identity: Mapping[Code, str] = {}
    stored_writes: StoredWrites = StoredWrites()
    lease: LeaseEntry = LeaseEntry()
    stop_fallback: StopFallback = "inhibit"
    slow: SlowAnswers = SlowAnswers()

    def asks_for_audit(self, now: DriveEntry) -> bool:
        """Whether what differs in its new entry calls for speaking to it as to another drive.

        What is read of it and what users may do with it are looked up when they count: neither
        says which drive it is, how it is spoken to, or what its watchdog shall be.
        """
        return self.model_copy(update={key: getattr(now, key) for key in OF_USE}) != now


class GroupEntry(_Model):
    """Drives spoken to together.

    Args:
        members: Their names, in the order of the roster's list.
        multicast_address: 10..90 or 0 if one telegram reaches exactly them; None: one by one.
        multicast: Whether everything that hears this address is in the roster, so that writes
            other than stops may go there too.
    """

    members: tuple[str, ...]
    multicast_address: int | None = None
    multicast: bool = False

    @property
    def write_address(self) -> int | None:
        """Where one telegram may be sent that is not a stop; None: one by one."""
        return self.multicast_address if self.multicast else None


class HttpAddress(_Model):
    """An address the API listens on."""

    host: str
    port: int

    def __str__(self) -> str:
        """Return `HOST:PORT`, as written in a roster."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"


class TlsEntry(_Model):
    """The TLS of the TCP server.

    Args:
        certificate: File with the certificate, then those between it and its authority (PEM).
        key: File with its private key.
        client_ca: File with the authorities of client certificates; None: none is asked for.
    """

    certificate: str
    key: str
    client_ca: str | None = None


class ApiEntry(_Model):
    """Where the API listens, and who may come in.

    Args:
        socket: The Unix socket.
        socket_group: Its group; None: that of the daemon.
        http: The address of the TCP server; None: there is none.
        hosts: Names that requests over TCP may use for this machine.
        tokens: The file of tokens; None: TCP answers reads of this machine.
        tls: Certificate and key of TCP; None: without TLS.
        read_only: Whether all writes are refused, except stops.
    """

    socket: str
    socket_group: str | None = None
    http: HttpAddress | None = None
    hosts: tuple[str, ...] = ()
    tokens: str | None = None
    tls: TlsEntry | None = None
    read_only: bool = False


class MqttEntry(_Model):
    """The message broker, and what the MQTT bridge does there.

    Args:
        host: The broker.
        port: Its TCP port.
        tls: Whether it is spoken to by TLS.
        ca: File with the authorities of its certificate (PEM); None: the system's.
        certificate: File with the bridge's certificate, then those between (PEM); None: none.
        key: File with its private key.
        username: Who the bridge is at the broker; None: nobody.
        password_file: File with the password, on its first line.
        topics: The first levels of all topics.
        control: Whether commands other than stops are carried out.
        home_assistant: The first levels of Home Assistant's discovery topics; None: no discovery.
    """

    host: str
    port: int
    tls: bool = True
    ca: str | None = None
    certificate: str | None = None
    key: str | None = None
    username: str | None = None
    password_file: str | None = None
    topics: str = "lecombus"
    control: bool = False
    home_assistant: str | None = None


class ModbusEntry(_Model):
    """The Modbus TCP bridge.

    Args:
        host: The address that it listens on.
        port: Its TCP port.
        units: The unit identifiers that it answers, 0..255.
        allow: Addresses and networks whose connections are taken; empty: those of this machine.
        control: Whether it writes; stops included.
    """

    host: str = "127.0.0.1"
    port: int = 502
    units: tuple[int, ...] = (1, 255)
    allow: tuple[str, ...] = ()
    control: bool = False


class MailEntry(_Model):
    """How messages are mailed.

    Args:
        to: The receivers.
        sender: The sender.
        host: The mail server; None: this computer's sendmail.
        port: Its TCP port; None: by `security`.
        security: TLS after STARTTLS, TLS from the first byte, or none.
        user: Who logs in; None: no login.
        password_file: The file with the password, the whole file without its last line end.
        ca: File with the authorities of the server's certificate; None: those of the system.
    """

    to: tuple[str, ...]
    sender: str
    host: str | None = None
    port: int | None = None
    security: MailSecurity = "starttls"
    user: str | None = None
    password_file: str | None = None
    ca: str | None = None


class MessageLimit(_Model):
    """So many messages may follow each other (`burst`), then one more in each `every_s` seconds."""

    burst: int = 5
    every_s: float = 300.0


class NotifyEntry(_Model):
    """What is sent to people when something happens.

    Args:
        command: A program and its arguments; empty: none. command_time_s: How long it may run.
        mail: How messages are mailed; None: they are not.
        events: What messages are sent of.
        ends: Whether they are also sent of its end.
        gather_s: How long is waited for more that belongs into the same message.
        limit: How often messages may be sent.
        daemon_gone_s: How long the daemon does not answer until it counts as lost.
    """

    command: tuple[str, ...] = ()
    command_time_s: float = 10.0
    mail: MailEntry | None = None
    events: tuple[NotifyEvent, ...] = get_args(NotifyEvent)
    ends: bool = True
    gather_s: float = 5.0
    limit: MessageLimit = MessageLimit()
    daemon_gone_s: float = 15.0


class JournalEntry(_Model):
    """The journal.

    Args:
        file: Its file.
        max_size: How large the file may become, bytes.
        on_failure: What happens to writes while it cannot be written; stops always go on.
    """

    file: str
    max_size: int = 256_000_000
    on_failure: OnJournalFailure = "refuse"


class Roster(_Model):
    """A whole roster.

    Args:
        file: Where it was read from, as named by the user.
        version: Of the form of the file.
        line: The line.
        drives: The drives, in the order of the file.
        groups: The groups by name; `all` is always one of them.
        lease: The default for all drives; each drive has its own resolved.
        on_shutdown: What is done to the drives at the end.
        api: Where the API listens.
        mqtt: The message broker; None: none.
        modbus: The Modbus TCP bridge; None: none.
        notify: What is sent to people; None: nothing.
        journal: The journal; None: none.
        state: The state file; None: nothing is kept.
    """

    file: str
    version: int = 1
    line: LineEntry
    drives: tuple[DriveEntry, ...]
    groups: Mapping[str, GroupEntry]
    lease: LeaseEntry = LeaseEntry()
    on_shutdown: OnShutdown = "nothing"
    api: ApiEntry
    mqtt: MqttEntry | None = None
    modbus: ModbusEntry | None = None
    notify: NotifyEntry | None = None
    journal: JournalEntry | None = None
    state: str | None = None

    @property
    def longest_wait_s(self) -> float:
        """How long a drive is waited for because the roster says so (`answer_time`), seconds."""
        return ANSWER_FACTOR * max((one.answer_time_s or 0.0 for one in self.drives), default=0.0)

    def drive(self, name: str) -> DriveEntry | None:
        """Return a drive by its name."""
        return next((entry for entry in self.drives if entry.name == name), None)


ON_DEMAND_GOOD_S: Final = 10.0
"""A value read once is called stale after this: about as long as a person looks at a screen."""

CYCLIC_GRACE_S: Final = 1.0
"""On top of two periods: a retry and a quarantine do not make a value stale."""

STRETCH_MOST: Final = 4.0
"""A roster that asks for more than this is not read that seldom because values stay good."""


def good_for_s(every_s: float | None, stretch: float) -> float:
    """Return how old a value may be before it counts as stale, seconds.

    Args:
        every_s: How often its code is read; None: not cyclically.
        stretch: The factor by which the roster's reads are stretched by plan (`capacity.load`), 1
            or more; not what a line did of late, which a pause of the daemon makes larger.
    """
    if every_s is None:
        return ON_DEMAND_GOOD_S
    return 2 * every_s * min(stretch, STRETCH_MOST) + CYCLIC_GRACE_S


def is_network_port(port: str) -> bool:
    """Return whether a roster's port is reached over TCP."""
    return port.startswith("socket://")


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine: `localhost` or a loopback address, maybe bracketed."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def group_entry(
    members: Sequence[str],
    addresses: Mapping[str, int],
    *,
    multicast: bool,
    address_of: MulticastAddress,
) -> GroupEntry:
    """Return a group with the address that reaches exactly its members.

    Args:
        members: The members' names.
        addresses: The addresses of all drives of the roster, by name.
        multicast: See `GroupEntry`.
        address_of: Gives the address that reaches exactly some of a line's drives.
    """
    wanted = frozenset(addresses[member] for member in members)
    address = address_of(wanted, frozenset(addresses.values()))
    return GroupEntry(members=tuple(members), multicast_address=address, multicast=multicast)


def with_address(roster: Roster, name: str, address: int, address_of: MulticastAddress) -> Roster:
    """Return a roster in which one drive has another address, as after a readdressing.

    The groups follow: a drive that has left its decade is no longer reached by the multicast of
    that decade, and would be reached by that of another.

    Args:
        roster: The roster.
        name: The drive.
        address: Its new address, free and valid.
        address_of: See `group_entry`.
    """
    drives = tuple(
        entry.model_copy(update={"address": address}) if entry.name == name else entry
        for entry in roster.drives
    )
    addresses = {entry.name: entry.address for entry in drives}
    groups = {
        title: group_entry(
            group.members, addresses, multicast=group.multicast, address_of=address_of
        )
        for title, group in roster.groups.items()
    }
    return roster.model_copy(update={"drives": drives, "groups": groups})
