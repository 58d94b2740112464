"""Every key of a roster, what it holds, and its words for editors: the grammar as one table.

Reading (`loading`) and the JSON Schema are both made from `roster_table`; a key that is added
here is read, refused, completed and shown in editors. What it does is then up to `checks` and
`building`.
"""

from __future__ import annotations

from functools import cache
from typing import Any, Final, get_args

from lecombus import roster
from lecombus.config.container_types import Key, ListOf, NamedEntries, ShortTable, Table
from lecombus.config.endpoint_types import (
    LONGEST_SOCKET_PATH,
    AbsolutePath,
    GroupName,
    Host,
    HttpType,
    IpAddress,
    MailAddress,
    Network,
    PortType,
    TopicPrefix,
)
from lecombus.config.mistakes import one_of
from lecombus.config.number_types import (
    Address,
    CodeType,
    Duration,
    Percent,
    Size,
    Whole,
    WholeChoice,
)
from lecombus.config.scalar_types import Keyword, Name, TextLine, WrongText, YesNo
from lecombus.fieldbus.protocols import Fieldbus, find, names, protocol_of

__all__ = ["ALL", "CYCLIC_SHORTEST_S", "ROSTER_VERSION", "roster_json_schema", "roster_table"]

ALL: Final = "all"
"""The group that always exists."""
CYCLIC_SHORTEST_S: Final = 0.01
"""No exchange is shorter at 19200 baud: a status read alone takes 13 ms on the wire."""
ROSTER_VERSION: Final = 1
"""The newest form of a roster; a change that an older lecombus would misunderstand raises it."""
_DAY_S: Final = 86400.0
_HOUR_S: Final = 3600.0

_DRIVE_NAME: Final = Name("drive", reserved={ALL: "`all` is the group of all drives"})
_GROUP_NAME: Final = Name("group")
_BY_PROTOCOL: Final = TextLine("what the protocol of the line says", 1)
"""Stands where the type depends on the protocol; `roster_table` sets it."""
_ECHO: Final = Keyword(
    get_args(roster.Echo),
    also={"true": "yes", "on": "yes", "yes": "yes", "false": "no", "off": "no", "no": "no"},
)
_ON_LAPSE: Final = Keyword(get_args(roster.Lapse))

_LINE: Final = Table("line", (
    Key("name", Name("line", capitals=True),
        "Name of the line: metrics label, socket and file names, lecombus@NAME.", required=True),
    Key("port", PortType(),
        "A device by its stable path (/dev/serial/by-id/..), socket://HOST:PORT, or sim: "
        "for built-in simulated drives.", required=True),
    Key("protocol", _BY_PROTOCOL, "What the drives speak.", default="lecom"),
    Key("baud", _BY_PROTOCOL, "Bits a second, the same in every drive (C0125, P411).",
        default=9600),
    Key("medium", Keyword(get_args(roster.Medium)),
        "The medium of the line. rs485 takes 31 drives (90 with repeaters), rs232 one, fibre 52.",
        default="rs485"),
    Key("repeaters", YesNo(), "An rs485 line with repeaters: 90 drives instead of 31.",
        default=False),
    Key("direction", Keyword(get_args(roster.Direction)),
        "Who switches the RS-485 transceiver: the adapter, the kernel's driver, or lecombus by "
        "RTS (which cannot promise the 1 ms that drives expect).", default="adapter"),
    Key("echo", _ECHO, "Whether everything sent comes back; auto finds out.", default="auto"),
    Key("parity", Keyword(get_args(roster.Parity)),
        "Who makes even parity: lecombus on an 8N1 port (line), or a device server that frames "
        "7E1 (port).", default="line"),
    Key("turnaround", Duration(0, 1),
        "Least pause between the end of an answer and the next telegram.", default="2ms"),
    Key("retries", Whole(0, 10), "Repetitions after a failed exchange, where repeating is safe.",
        default=2),
    Key("tolerate", Whole(0, 3),
        "Lost answers within any watchdog time that no watchdog acts upon; rosters that cannot "
        "hold that are refused.", default=1),
    Key("adapter_latency", Duration(0, 1),
        "What the adapter adds to an answer. Absent: by the kind of port."),
    Key("late_answer", Duration(0.01, 10),
        "How late an answer may still come after a time-out; a request that it could seem to "
        "answer waits that long.",
        default="500ms"),
    Key("absent_share", Percent(1, 50),
        "Largest share of line time spent on drives that do not answer.", default="10%"),
    Key("stall", Duration(1, _HOUR_S, zero="never"),
        "Silence of all drives after which the port is reopened; 0 for never.", default="30s"),
), "The serial line and its port.")  # fmt: skip

_WATCHDOG: Final = Table("watchdog", (
    Key("time", Duration(0.001, 100),
        "Time without a telegram after which the drive acts. 2102 module: 50ms to 65.535s; "
        "SMVector: up to 65s.", required=True),
    Key("action", TextLine("none, inhibit, quick-stop or trip", 20),
        "What the drive does: none, inhibit, quick-stop, or trip (SMVector).", required=True),
    Key("configure", YesNo(),
        "Write time and action into the drive at start and after each power cycle; otherwise "
        "differences are only reported.", default=False),
), "The timer in the drive that stops it when the line goes quiet; lecombus feeds it.")  # fmt: skip

_CYCLIC: Final = Table("cyclic read", (
    Key("code", _BY_PROTOCOL, "The code, with its subcode after a slash.", required=True),
    Key("every", Duration(CYCLIC_SHORTEST_S, _DAY_S), "How often it is read.", required=True),
))  # fmt: skip

_LEASE: Final = Table("lease", (
    Key("required", YesNo(), "Whether control of the drive needs a lease.", default=False),
    Key("time", Duration(0.1, _HOUR_S),
        "The longest time that a lease may last without a renewal.", default="2s"),
    Key("on_lapse", _ON_LAPSE,
        "What happens when it lapses; hold means nothing, and shows as an alarm.",
        default="quick-stop"),
), "A client that must show that it is alive, and what is done when it does not.")  # fmt: skip

_STORED_WRITES: Final = Table("stored writes", (
    Key("burst", Whole(1, 10_000), "How many writes of one code may follow each other.",
        default=30),
    Key("every", Duration(0.1, _DAY_S, zero="no limit"),
        "How long until one more of that code may follow; 0 for no limit.", default="10min"),
), "Limit on writes of codes that wear the drive's memory.")  # fmt: skip

_DRIVE: Final = Table("drive", (
    Key("name", _DRIVE_NAME, "Name of the drive in commands, URLs and metrics.", required=True),
    Key("address", _BY_PROTOCOL, "1..99 without 10, 20 .. 90 (C0009, P410).", required=True),
    Key("family", _BY_PROTOCOL,
        "What it is; generic for any other device that speaks LECOM-A/B.", required=True),
    Key("watchdog", _WATCHDOG, _WATCHDOG.doc),
    Key("cyclic", _BY_PROTOCOL,
        "What is read all the time. Absent: the family's status set; [] for nothing."),
    Key("writable", _BY_PROTOCOL,
        "What may be written, instead of the family's set; [] for nothing. To add codes to that "
        "set, use also_writable."),
    Key("also_writable", _BY_PROTOCOL,
        "What may be written in addition to `writable` or, without it, to the family's set."),
    Key("unchecked", _BY_PROTOCOL,
        "Codes that take any value, because this drive's range is not its manual's."),
    Key("allow_address_change", YesNo(),
        "Let `lecombus readdress` change the drive's address; plain writes never do.",
        default=False),
    Key("restore", YesNo(),
        "Let `lecombus restore` write parameters that `writable` does not list.", default=False),
    Key("answer_time", Duration(0.001, 10),
        "Its processing time, where it differs from its family's."),
    Key("addressing", Keyword(get_args(roster.Addressing)),
        "Code addressing it understands; standard for devices that know no extended addressing. "
        "Absent: as its family."),
    Key("accept_software", ListOf(TextLine("a software version such as 1.30", 20), "the version"),
        "Software versions (P494 of an SMVector) that may be written to besides the manual's."),
    Key("identity", _BY_PROTOCOL,
        "What identity codes such as C0200 or C1810 must read; else nothing but stops is written."),
    Key("stop_fallback", Keyword(get_args(roster.StopFallback)),
        "What a quick stop becomes that the drive refuses, does not show, or that cannot be made "
        "from its control word: an inhibit, whereupon the motor coasts, or none, as for a hoist.",
        default="inhibit"),
    Key("stored_writes", _STORED_WRITES, _STORED_WRITES.doc),
    Key("lease", _LEASE, _LEASE.doc),
), "A drive on the line.")  # fmt: skip

_MULTICAST: Final = Key(
    "multicast", YesNo(),
    "Whether everything on the cable that hears the group's telegram is in the roster: then writes "
    "are sent as one too. Otherwise one write follows the other.", default=False,
)  # fmt: skip

_ALL_DRIVES: Final = Table("group of all drives", (_MULTICAST,), "All drives of the roster.")

_GROUP: Final = Table("group", (
    Key("members", ListOf(TextLine("a drive's name", Name.LONGEST), "the member", least=1),
        "Names of drives. A stop is sent as one telegram where they are exactly the drives of one "
        "decade of addresses, or all drives.", required=True),
    _MULTICAST,
))  # fmt: skip

_TLS: Final = Table("tls", (
    Key("certificate", AbsolutePath("/etc/lecombus/tls.pem"),
        "PEM file: the certificate, then those between it and its authority.", required=True),
    Key("key", AbsolutePath("/etc/lecombus/tls.key"),
        "PEM file: its private key, which others may not read.", required=True),
    Key("client_ca", AbsolutePath("/etc/lecombus/clients.pem"),
        "PEM file: the authorities of client certificates. Absent: clients need none."),
), "The certificate of TCP; read again at each reload.")  # fmt: skip

_API: Final = Table("api", (
    Key("socket", AbsolutePath("/run/lecombus/hall-3.sock", LONGEST_SOCKET_PATH),
        "The Unix socket. Absent: /run/lecombus/NAME.sock with the line's name."),
    Key("socket_group", GroupName(),
        "The group that may open the Unix socket, which is to read, write and stop. Absent: that "
        "of the daemon."),
    Key("http", HttpType(),
        "HOST:PORT for HTTP over TCP; other than loopback only with tokens and tls. Absent: none."),
    Key("hosts", ListOf(Host(), "the host"),
        "Names that requests over TCP use for this machine, besides its addresses."),
    Key("tokens", AbsolutePath("/etc/lecombus/tokens"),
        "File of tokens (`lecombus token`): every request over TCP needs one. Absent: TCP answers "
        "reads of this machine."),
    Key("tls", _TLS, _TLS.doc),
    Key("read_only", YesNo(), "Whether all writes are refused, except stops.", default=False),
), "Where programs reach the daemon, and what they may do.")  # fmt: skip

_MQTT: Final = Table("mqtt", (
    Key("host", Host(), "The broker.", required=True),
    Key("port", Whole(1, 65535), "Absent: 8883 with TLS, 1883 without."),
    Key("tls", YesNo(), "Whether the broker is spoken to by TLS.", default=True),
    Key("ca", AbsolutePath("/etc/lecombus/mqtt-ca.pem"),
        "PEM file: the authorities of the broker's certificate. Absent: the system's."),
    Key("certificate", AbsolutePath("/etc/lecombus/mqtt.pem"),
        "PEM file: the bridge's certificate, for a broker that asks for one."),
    Key("key", AbsolutePath("/etc/lecombus/mqtt.key"), "PEM file: its private key."),
    Key("username", TextLine("a user name of the broker"),
        "Who the bridge is at the broker. Absent: it gives no name."),
    Key("password_file", AbsolutePath("/etc/lecombus/mqtt-password"),
        "File with the password, alone on its first line."),
    Key("topics", TopicPrefix(), "The first levels of all topics.", default="lecombus"),
    Key("control", YesNo(),
        "Whether commands other than stops are carried out.", default=False),
    Key("home_assistant", TopicPrefix(),
        "The first levels of Home Assistant's discovery topics, such as homeassistant. Absent: "
        "drives are not made known to it."),
), "The message broker of the MQTT bridge (`lecombus bridge mqtt`).")  # fmt: skip

_MODBUS: Final = Table("modbus", (
    Key("host", IpAddress(),
        "The address that the bridge listens on; beyond loopback only with allow.",
        default="127.0.0.1"),
    Key("port", Whole(1, 65535), "Its TCP port.", default=502),
    Key("units", ListOf(Whole(0, 255), "the unit identifier", least=1),
        "The unit identifiers that it answers.", default=[1, 255]),
    Key("allow", ListOf(Network(), "the address"),
        "Addresses and networks that may connect, such as 192.0.2.7 or 192.0.2.0/24. Modbus has no "
        "passwords. Absent: this machine only."),
    Key("control", YesNo(),
        "Whether the bridge writes: setpoints and commands under a lease, and stops.",
        default=False),
), "The Modbus TCP bridge (`lecombus bridge modbus`).")  # fmt: skip

_MAIL: Final = Table("mail", (
    Key("to", ListOf(MailAddress(), "the address", least=1), "The receivers.", required=True),
    Key("from", MailAddress(), "The sender.", required=True),
    Key("host", Host(), "The mail server. Absent: /usr/sbin/sendmail of this computer."),
    Key("port", Whole(1, 65535), "Absent: 587, with `security: tls` 465, with none 25."),
    Key("security", Keyword(get_args(roster.MailSecurity)),
        "TLS after STARTTLS, TLS from the first byte, or none.", default="starttls"),
    Key("user", TextLine("the name to log in with"), "Who logs in. Absent: no login."),
    Key("password_file", AbsolutePath("/etc/lecombus/mail-password"),
        "File with the password, which others may not read."),
    Key("ca", AbsolutePath("/etc/lecombus/mail-ca.pem"),
        "PEM file: the authorities of the server's certificate. Absent: those of the system."),
), "Messages by mail.")  # fmt: skip

_LIMIT: Final = Table("limit", (
    Key("burst", Whole(1, 100), "How many messages may follow each other.", default=5),
    Key("every", Duration(1, _DAY_S), "How long until one more may follow.", default="5min"),
), "How often messages are sent; what happens in between stands in the next one.")  # fmt: skip

_NOTIFY: Final = Table("notify", (
    Key("command", ListOf(TextLine("a word of the command", 1000), "the word", least=1),
        "A program by its absolute path and its arguments, run without a shell; the message is "
        "JSON on its standard input."),
    Key("command_time", Duration(0.1, 600), "How long the command may run.", default="10s"),
    Key("mail", _MAIL, _MAIL.doc),
    Key("events", ListOf(Keyword(get_args(roster.NotifyEvent)), "the event", least=1),
        "What messages are sent of.", default=list(get_args(roster.NotifyEvent))),
    Key("ends", YesNo(), "Whether messages are also sent when it ends.", default=True),
    Key("gather", Duration(0, _HOUR_S),
        "How long to wait for more that belongs into the same message.", default="5s"),
    Key("limit", _LIMIT, _LIMIT.doc),
    Key("daemon_gone", Duration(1, _HOUR_S),
        "How long the daemon does not answer until it counts as lost.", default="15s"),
), "Messages to people, by command or mail (`lecombus bridge notify`).")  # fmt: skip

_JOURNAL: Final = ShortTable("journal", (
    Key("file", AbsolutePath("/var/lib/lecombus/hall-3.sqlite"),
        "Its file, made where there is none.", required=True),
    Key("max_size", Size(32, 100_000),
        "How large the file may become; then the oldest rows are deleted.", default="256MB"),
    Key("on_failure", Keyword(get_args(roster.OnJournalFailure)),
        "What happens to writes while the journal cannot be written: refuse, or go-on without it. "
        "Stops, reads and the feeding of watchdogs always go on.", default="refuse"),
), "The record of writes, stops, trips and losses, and of who asked; by its file alone, or with "
   "more keys. Absent: none is kept.")  # fmt: skip

_ROSTER: Final = Table("roster", (
    Key("version", WholeChoice((ROSTER_VERSION,)),
        "Of the form of this file. A lecombus that knows only older ones refuses it.",
        default=ROSTER_VERSION),
    Key("line", _BY_PROTOCOL, _LINE.doc, required=True),
    Key("drives", _BY_PROTOCOL, "The drives on the line.", required=True),
    Key("groups", NamedEntries(_GROUP_NAME, _GROUP, special={ALL: _ALL_DRIVES}),
        "Drives spoken to together. The group `all` always exists and takes only `multicast`."),
    Key("lease", _LEASE, "The default for all drives."),
    Key("on_shutdown", Keyword(get_args(roster.OnShutdown)),
        "What is sent to all drives when the daemon ends.", default="nothing"),
    Key("api", _API, _API.doc),
    Key("mqtt", _MQTT, _MQTT.doc),
    Key("modbus", _MODBUS, _MODBUS.doc),
    Key("notify", _NOTIFY, _NOTIFY.doc),
    Key("journal", _JOURNAL, _JOURNAL.doc),
    Key("state", AbsolutePath("/var/lib/lecombus/hall-3.json"),
        "What must outlive the daemon: identities and write counts. Absent: "
        "/var/lib/lecombus/NAME.json with the line's name; for sim: nothing is kept."),
), "One line of drives, read by one lecombus process.")  # fmt: skip


class _FamilyName(Keyword):
    """The name of a family that speaks the protocol of the line."""

    def __init__(self, own: Fieldbus) -> None:
        super().__init__(own.families)
        self._protocol = own.name

    def _convert(self, text: str) -> str:
        other = None if text in self._words else protocol_of(text)
        if other is not None:
            what = f"speaks {other}, and the protocol of the line is {self._protocol}"
            raise WrongText(what, f"{one_of(self._words)} would be right, or protocol: {other}")
        return super()._convert(text)


@cache
def roster_table(protocol: str) -> Table:
    """Return the table of a whole roster.

    Args:
        protocol: The protocol of its line, one that is known.
    """
    own = find(protocol)
    code = CodeType(own.rules)
    codes = ListOf(code, "the code")
    line = _LINE.with_types(
        {"protocol": Keyword(names()), "baud": WholeChoice(own.bauds)}, own.unused_keys
    )
    drive = _DRIVE.with_types({
        "address": Address(own),
        "family": _FamilyName(own),
        "cyclic": ListOf(_CYCLIC.with_types({"code": code}), "the cyclic read"),
        "writable": codes,
        "also_writable": codes,
        "unchecked": codes,
        "identity": NamedEntries(code, TextLine("what the drive says of itself", 240)),
    }, own.unused_keys)  # fmt: skip
    return _ROSTER.with_types({"line": line, "drives": ListOf(drive, "the drive", least=1)})


def roster_json_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a roster, for editors.

    It knows keys, words and forms of a LECOM line. Rules between keys, ranges of durations and
    everything that follows from a drive's family are known to `lecombus check` only.
    """
    schema = "https://json-schema.org/draft/2020-12/schema"
    return {"$schema": schema, "title": "lecombus roster", **roster_table("lecom").schema}
