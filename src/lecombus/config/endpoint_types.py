"""Types of values that name something outside: ports, sockets, files, hosts.

They are checked by their form only: a roster is checked on machines that have neither the device
nor the directory.
"""

from __future__ import annotations

import contextlib
import ipaddress
import re
from typing import Final

from lecombus.config.mistakes import did_you_mean, nearest, one_of, shown
from lecombus.config.scalar_types import ScalarType, WrongText
from lecombus.roster import is_loopback

__all__ = [
    "AbsolutePath",
    "GroupName",
    "Host",
    "HttpType",
    "IpAddress",
    "MailAddress",
    "Network",
    "PortType",
    "TopicPrefix",
]

_SCHEMES: Final = ("socket", "sim")
_HOST_PORT: Final = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):([0-9]{1,5})", re.ASCII)
_PORT_FORMS: Final = "a device path, socket://HOST:PORT or sim:"
_RAW_SERVER: Final = (
    "write socket://{where} and have the device server pass raw bytes at 8 data bits, no parity, 1 "
    "stop bit; for ser2net: `accepter: tcp,{port}` and `connector: serialdev,/dev/ttyUSB0,BAUDn81,"
    "local` with the line's baud; a server that can only do 7E1 works with `parity: port`"
)
"""What to have instead of rfc2217://: nothing needs remote control of a port (ADR 3)."""
LONGEST_SOCKET_PATH: Final = 107
"""Linux takes 108 bytes with the closing NUL (unix(7), `sun_path`)."""


def _split_host_port(text: str) -> tuple[str, int]:
    match = _HOST_PORT.fullmatch(text)
    if match is None:
        raise WrongText("is not HOST:PORT", "write it like 127.0.0.1:9740 or [::1]:9740")
    if int(match[2]) > 65535:
        raise WrongText("has a port number out of range", "1 to 65535 would be right")
    return match[1].strip("[]"), int(match[2])


class PortType(ScalarType):
    """The port of a line: a device, a device server, or the simulator."""

    def __init__(self) -> None:
        pattern = r"^(/.*[^/]|socket://[^/?]+:[0-9]{1,5}|sim:?)$"
        super().__init__(_PORT_FORMS, {"type": "string", "pattern": pattern})

    def _convert(self, text: str) -> str:
        if not text or not text.isprintable() or text != text.strip():
            raise WrongText("is not a port", f"give {_PORT_FORMS}")
        if text.startswith("/"):
            return self._device(text)
        if text in ("sim", "sim:"):
            return "sim:"  # YAML wants quotes around a value that ends in a colon
        scheme, colon, rest = text.partition(":")
        if colon and scheme == "sim":
            raise WrongText("has something behind `sim:`", 'write "sim:": it simulates the drives')
        if colon and scheme in _SCHEMES:
            return self._network(text, scheme, rest)
        if colon and scheme.lower() == "rfc2217":
            raise self._remote_control(rest)
        if colon:
            right = did_you_mean(scheme, _SCHEMES, f"{one_of(_SCHEMES)} would be right")
            raise WrongText(f"has the unknown scheme {shown(scheme)}", right)
        if text.startswith("tty"):
            raise WrongText("is not a whole path", f"write /dev/{text}")
        meant = nearest(text, _SCHEMES)
        raise WrongText(
            "is not a port", f"did you mean `{meant}:`?" if meant else f"give {_PORT_FORMS}"
        )

    def _device(self, text: str) -> str:
        if text.endswith("/"):
            raise WrongText("is a directory", f"name the device in it, such as {text}NAME")
        return text

    def _network(self, text: str, scheme: str, rest: str) -> str:
        right = f"write {scheme}://HOST:PORT, such as {scheme}://192.0.2.7:4001"
        if not rest.startswith("//"):
            raise WrongText("has no host", right)
        try:
            host, number = _split_host_port(rest[2:])
            if rest.startswith("//["):
                ipaddress.IPv6Address(host)
        except (WrongText, ipaddress.AddressValueError) as exc:
            raise WrongText("is not a host with a port", right) from exc
        if number == 0:
            raise WrongText("has the port number 0", right)
        return text

    def _remote_control(self, rest: str) -> WrongText:
        where, port = "HOST:4001", 4001
        with contextlib.suppress(WrongText):
            given = rest.removeprefix("//").split("?")[0].rstrip("/")
            _, port = _split_host_port(given)
            where = given
        return WrongText("is not supported", _RAW_SERVER.format(where=where, port=port))


class HttpType(ScalarType):
    """Where the API listens on TCP: an address of this machine. `checks` says which need more."""

    def __init__(self) -> None:
        pattern = r"^(localhost|[0-9.]+|\[[0-9A-Fa-f:.]+\]):[0-9]{1,5}$"
        super().__init__(
            "HOST:PORT, such as 127.0.0.1:9740", {"type": "string", "pattern": pattern}
        )

    def _convert(self, text: str) -> tuple[str, int]:
        host, number = _split_host_port(text)
        if not is_loopback(host):
            try:
                ipaddress.ip_address(host)
            except ValueError:
                raise WrongText(
                    "does not begin with an address of this machine",
                    f"write an IP address such as 127.0.0.1:{number}; names belong to `hosts`",
                ) from None
        return host, number


class GroupName(ScalarType):
    """A group of users of this machine."""

    def __init__(self) -> None:
        pattern = "[A-Za-z_][A-Za-z0-9_.-]{0,31}"
        super().__init__("a group of users", {"type": "string", "pattern": f"^{pattern}$"})
        self._form = re.compile(pattern, re.ASCII)

    def _convert(self, text: str) -> str:
        if self._form.fullmatch(text) is None:
            raise WrongText("is not a group", f"give {self.expects}, such as operators")
        return text


class AbsolutePath(ScalarType):
    """A file, by its whole path.

    Args:
        example: One, for messages.
        longest: Most bytes.
    """

    def __init__(self, example: str, longest: int = 4095) -> None:
        super().__init__(
            f"an absolute path such as {example}",
            {"type": "string", "pattern": "^/.*[^/]$", "maxLength": longest},
        )
        self._example = example
        self._longest = longest

    def _convert(self, text: str) -> str:
        if not text.startswith("/") or not text.isprintable():
            raise WrongText("is not an absolute path", f"write it from /, such as {self._example}")
        if text.endswith("/"):
            raise WrongText("is a directory", f"name a file, such as {self._example}")
        size = len(text.encode())
        if size > self._longest:
            raise WrongText(f"is too long: {size} bytes", f"at most {self._longest} are possible")
        return text


class Host(ScalarType):
    """A host by name or address."""

    def __init__(self) -> None:
        schema = {"type": "string", "pattern": "^[A-Za-z0-9._:-]{1,253}$"}
        super().__init__("a host name or address", schema)

    def _convert(self, text: str) -> str:
        labels = text.removesuffix(".").split(".")
        is_name = re.fullmatch(r"[A-Za-z0-9._:-]{1,253}", text, re.ASCII) is not None
        if not is_name or not all(0 < len(label) <= 63 for label in labels):
            raise WrongText("is not a host", f"give {self.expects}")
        if re.fullmatch(r"[A-Za-z0-9._-]+:[0-9]+", text):
            raise WrongText("has a port in it", "give the port by the key `port`")
        return text


class IpAddress(ScalarType):
    """An IP address of this machine, without a port."""

    def __init__(self) -> None:
        schema = {"type": "string", "pattern": "^([0-9.]+|[0-9A-Fa-f:.]+)$"}
        super().__init__("an IP address such as 127.0.0.1", schema)

    def _convert(self, text: str) -> str:
        try:
            return str(ipaddress.ip_address(text))
        except ValueError:
            raise WrongText("is no IP address", f"give {self.expects}") from None


class Network(ScalarType):
    """An IP address or a network of them."""

    def __init__(self) -> None:
        schema = {"type": "string", "pattern": "^[0-9A-Fa-f:.]+(/[0-9]{1,3})?$"}
        super().__init__("an address such as 192.0.2.7, or 192.0.2.0/24", schema)

    def _convert(self, text: str) -> str:
        try:
            return str(ipaddress.ip_network(text))
        except ValueError:
            pass
        try:
            meant = ipaddress.ip_network(text, strict=False)
        except ValueError:
            raise WrongText("is not an address", f"give {self.expects}") from None
        raise WrongText("has bits behind its network part", f"write {meant}")


class MailAddress(ScalarType):
    """An address of mail: the bare address, without a name beside it."""

    def __init__(self) -> None:
        pattern = "[A-Za-z0-9.!#$%&'*+/=?^_`{|}~-]{1,64}@[A-Za-z0-9.-]{1,253}"
        super().__init__(
            "an address such as duty@example.org", {"type": "string", "pattern": f"^{pattern}$"}
        )
        self._form = re.compile(pattern, re.ASCII)

    def _convert(self, text: str) -> str:
        if self._form.fullmatch(text) is None:
            raise WrongText("is not a mail address", f"give {self.expects}")
        return text


class TopicPrefix(ScalarType):
    """The first levels of MQTT topics: names with slashes between them."""

    _FORM: Final = re.compile(r"[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*", re.ASCII)
    _LONGEST: Final = 64

    def __init__(self) -> None:
        schema = {
            "type": "string", "pattern": "^[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*$",
            "maxLength": self._LONGEST,
        }  # fmt: skip
        super().__init__("the first levels of topics, such as plant/lecombus", schema)

    def _convert(self, text: str) -> str:
        if self._FORM.fullmatch(text) is None:
            right = "use letters, digits, _ . - and a slash between two levels"
            raise WrongText("is not usable in topics", right)
        if len(text) > self._LONGEST:
            raise WrongText(f"has {len(text)} characters", f"at most {self._LONGEST} are usable")
        return text
