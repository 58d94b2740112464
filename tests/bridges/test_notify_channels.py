"""Messages over real channels: commands, a mail server (aiosmtpd), a sendmail."""

from __future__ import annotations

import email
import email.policy
import json
import socket
import ssl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from email.message import EmailMessage
from pathlib import Path
from typing import Any

import anyio
import pytest
from aiosmtpd.controller import Controller
from aiosmtpd.smtp import SMTP, AuthResult, Envelope, LoginPassword, Session

from lecombus.bridges.notify.channels import (
    Channel,
    CommandChannel,
    MailServerChannel,
    NotSentError,
    SendmailChannel,
    channels_of,
)
from lecombus.bridges.notify.conditions import Happening
from lecombus.bridges.notify.messages import Notification, Pending, message_of
from lecombus.roster import MailEntry, NotifyEntry
from support.certificates import Certificates, make_certificates
from support.daemon_host import free_port, until

pytestmark = [
    pytest.mark.clock,
    # aiosmtpd says that of a server that speaks TLS from the first byte, too.
    pytest.mark.filterwarnings("ignore:Requiring AUTH while not requiring TLS"),
]

PASSWORD = "hunter2-Ω"


def message() -> Notification:
    pending = Pending(ends=True)
    pending.add(Happening("trip", "feeder", True, "trip OH (50): Kühlkörper zu heiß", 1.0))
    entries, dropped = pending.take()
    return message_of("hall-3", entries, dropped, 1_795_000_000.0)


def send(channel: Channel, what: Notification | None = None) -> None:
    anyio.run(channel.send, what or message())


def refusal(channel: Channel, what: Notification | None = None) -> str:
    """Why a message was not sent."""
    with pytest.raises(NotSentError) as caught:
        send(channel, what)
    return str(caught.value)


# ---- commands -----------------------------------------------------------------------------------


def script(folder: Path, text: str) -> str:
    path = folder / "page"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


def test_a_command_gets_json_and_variables_and_no_shell_reads_its_arguments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SECRET_OF_OURS", "x")
    program = script(tmp_path, f'cd {tmp_path}; cat > in; env > env; echo "$1|$2" > words')
    send(CommandChannel((program, "$(touch hacked)", "a b; exit 3"), 10.0))
    document = json.loads((tmp_path / "in").read_text())
    assert document["events"][0]["text"] == "trip OH (50): Kühlkörper zu heiß"
    assert (tmp_path / "words").read_text() == "$(touch hacked)|a b; exit 3\n"
    lines = (tmp_path / "env").read_text().splitlines()
    found = dict(line.partition("=")[::2] for line in lines)
    assert (found["LECOMBUS_EVENTS"], found["LECOMBUS_DRIVES"]) == ("trip", "feeder")
    assert (found["LECOMBUS_ACTIVE"], found["LECOMBUS_TEST"]) == ("1", "0")
    assert "SECRET_OF_OURS" not in found


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("echo no pager >&2; exit 3", "ended with status 3: no pager"),
        ("kill -9 $$", "ended with status -9"),
    ],
)
def test_a_command_that_fails_says_why(tmp_path: Path, text: str, said: str) -> None:
    assert refusal(CommandChannel((script(tmp_path, text),), 10.0)).endswith(said)


def test_a_command_that_is_not_there_says_so(tmp_path: Path) -> None:
    found = refusal(CommandChannel((str(tmp_path / "nothing"),), 10.0))
    assert found.endswith("cannot be started: No such file or directory")


def test_a_command_that_reads_nothing_and_says_very_much_is_no_trouble(tmp_path: Path) -> None:
    long = Notification("hall-3", "s", "x" * 3_000_000, (), 1.0)
    send(CommandChannel((script(tmp_path, "exec true"),), 10.0), long)
    noisy = script(tmp_path, "head -c 3000000 /dev/zero | tr '\\0' x >&2; exit 1")
    assert len(refusal(CommandChannel((noisy,), 20.0))) < 500


def test_a_command_that_takes_too_long_is_killed_with_all_it_started(tmp_path: Path) -> None:
    program = script(tmp_path, f"sleep 600 & echo $! > {tmp_path}/pid; sleep 600")
    begun_s = time.monotonic()
    found = refusal(CommandChannel((program,), 0.5))
    assert found.endswith("did not end within 0.5 s")
    assert time.monotonic() - begun_s < 60
    child = int((tmp_path / "pid").read_text())
    until(lambda: not is_running(child), "its child is gone")


def test_a_command_that_leaves_something_behind_does_not_hold_the_message(tmp_path: Path) -> None:
    program = script(tmp_path, f"sleep 600 & echo $! > {tmp_path}/pid; exit 0")
    send(CommandChannel((program,), 30.0))
    child = int((tmp_path / "pid").read_text())
    until(lambda: not is_running(child), "its child is gone")


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


# ---- mail ---------------------------------------------------------------------------------------


class Inbox:
    """What a mail server took; it refuses one receiver."""

    def __init__(self) -> None:
        self.mails: list[tuple[Envelope, bool]] = []

    async def handle_RCPT(  # noqa: N802 - aiosmtpd wants this name
        self, server: SMTP, session: Session, envelope: Envelope, address: str, options: list[str]
    ) -> str:
        if address.startswith("nobody"):
            return "550 no such user"
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(  # noqa: N802
        self, server: SMTP, session: Session, envelope: Envelope
    ) -> str:
        self.mails.append((envelope, session.ssl is not None))
        return "250 OK"

    def only(self) -> EmailMessage:
        ((envelope, _),) = self.mails
        assert isinstance(envelope.content, bytes)
        found = email.message_from_bytes(envelope.content, policy=email.policy.default)
        assert isinstance(found, EmailMessage)
        return found


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return make_certificates(tmp_path_factory.mktemp("tls"))


def server_context(made: Certificates) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(made.path("server.pem"), made.path("server.key"))
    return context


def knows(
    server: SMTP, session: Session, envelope: Envelope, mechanism: str, login: Any
) -> AuthResult:
    assert isinstance(login, LoginPassword)
    good = (login.login, login.password) == (b"hall-3", PASSWORD.encode())
    # A server that repeats what it got: it must not reach our log.
    why = None if good else f"535 5.7.8 wrong: {login.password.decode()}"
    return AuthResult(success=good, handled=why is None, message=why)


@contextmanager
def mail_server(
    made: Certificates | None = None, security: str = "none"
) -> Iterator[tuple[Inbox, int]]:
    """A mail server; with certificates it wants TLS and a login."""
    inbox, port = Inbox(), free_port()
    options: dict[str, Any] = {}
    if made is not None and security == "starttls":
        options = {"tls_context": server_context(made), "require_starttls": True}
    elif made is not None:
        options = {"ssl_context": server_context(made)}
    if made is not None:
        options |= {"authenticator": knows, "auth_required": True,
                    "auth_require_tls": security == "starttls"}  # fmt: skip
    controller = Controller(inbox, hostname="127.0.0.1", port=port, **options)
    controller.start()
    try:
        yield inbox, port
    finally:
        controller.stop()


def mail(port: int, **more: Any) -> MailEntry:
    to = ("duty@example.org", "boss@example.org")
    settings: dict[str, Any] = {"to": to, "sender": "hall-3@example.org", "host": "127.0.0.1"}
    settings |= {"port": port, "security": "none"}
    return MailEntry(**(settings | more))


def with_login(folder: Path, made: Certificates, **more: Any) -> dict[str, Any]:
    path = folder / "password"
    path.write_text(PASSWORD + "\n")
    path.chmod(0o600)
    return {"user": "hall-3", "password_file": str(path), "ca": str(made.path("ca.pem")), **more}


def test_a_mail_arrives_as_it_should() -> None:
    with mail_server() as (inbox, port):
        send(MailServerChannel(mail(port)))
        ((envelope, _),) = inbox.mails
        found = inbox.only()
    assert envelope.mail_from == "hall-3@example.org"
    assert envelope.rcpt_tos == ["duty@example.org", "boss@example.org"]
    assert found["Subject"] == "lecombus hall-3: feeder: trip OH (50): Kühlkörper zu heiß"
    assert found["To"] == "duty@example.org, boss@example.org"
    assert found["Auto-Submitted"] == "auto-generated"
    assert found["Date"].datetime.year == 2026
    assert found["Message-ID"].endswith("@example.org>")
    assert "Kühlkörper" in found.get_content()


@pytest.mark.parametrize("security", ["starttls", "tls"])
def test_a_mail_goes_by_tls_with_a_login(
    tmp_path: Path, certificates: Certificates, security: str
) -> None:
    with mail_server(certificates, security) as (inbox, port):
        send(MailServerChannel(mail(port, security=security, **with_login(tmp_path, certificates))))
        ((_, by_tls),) = inbox.mails
    assert by_tls or security == "tls"  # aiosmtpd notes only STARTTLS in its session


def test_a_server_with_another_certificate_gets_no_password(
    tmp_path: Path, certificates: Certificates
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    login = with_login(tmp_path, certificates, ca=str(make_certificates(other).path("ca.pem")))
    for security in ("starttls", "tls"):
        with mail_server(certificates, security) as (inbox, port):
            found = refusal(MailServerChannel(mail(port, security=security, **login)))
        assert "CERTIFICATE_VERIFY_FAILED" in found
        assert inbox.mails == []


def test_a_server_without_tls_gets_no_password(tmp_path: Path, certificates: Certificates) -> None:
    with mail_server() as (inbox, port):
        login = with_login(tmp_path, certificates)
        found = refusal(MailServerChannel(mail(port, security="starttls", **login)))
    assert "STARTTLS" in found
    assert inbox.mails == []


def test_a_wrong_password_is_not_logged_even_if_the_server_repeats_it(
    tmp_path: Path, certificates: Certificates
) -> None:
    login = with_login(tmp_path, certificates, user="somebody-else")
    with mail_server(certificates, "starttls") as (inbox, port):
        found = refusal(MailServerChannel(mail(port, security="starttls", **login)))
    assert "535" in found
    assert PASSWORD not in found
    assert "***" in found
    assert inbox.mails == []


@pytest.mark.parametrize(("mode", "content", "said"), [
    (0o644, "secret", "all users may read the password file"),
    (0o600, "", "is empty"),
    (None, "", "cannot be read: No such file or directory"),
])  # fmt: skip
def test_a_password_file_is_checked(
    tmp_path: Path, mode: int | None, content: str, said: str
) -> None:
    path = tmp_path / "password"
    if mode is not None:
        path.write_text(content)
        path.chmod(mode)
    entry = mail(1, security="starttls", user="me", password_file=str(path))
    assert said in refusal(MailServerChannel(entry))


def test_a_server_that_is_down_or_refuses_a_receiver_says_so() -> None:
    assert "127.0.0.1" in refusal(MailServerChannel(mail(free_port())))
    with mail_server() as (inbox, port):
        found = refusal(MailServerChannel(mail(port, to=("nobody@example.org",))))
        assert "550" in found
        assert inbox.mails == []
        found = refusal(MailServerChannel(mail(port, to=("a@b.example", "nobody@b.example"))))
        assert "refused nobody@b.example: 550 no such user" in found
        assert len(inbox.mails) == 1


def test_a_server_that_says_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lecombus.bridges.notify.channels.MAIL_WITHIN_S", 0.5)
    with socket.socket() as deaf:
        deaf.bind(("127.0.0.1", 0))
        deaf.listen()
        assert "127.0.0.1" in refusal(MailServerChannel(mail(deaf.getsockname()[1])))


def test_sendmail_gets_the_mail_and_the_receivers(tmp_path: Path) -> None:
    program = script(tmp_path, f"printf '%s\\n' \"$@\" > {tmp_path}/words; cat > {tmp_path}/mail")
    entry = MailEntry(to=("a@b.example", "c@d.example"), sender="hall-3@example.org")
    send(SendmailChannel(entry, program))
    words = (tmp_path / "words").read_text().split()
    assert words == ["-i", "-f", entry.sender, "--", *entry.to]
    found = email.message_from_bytes((tmp_path / "mail").read_bytes(), policy=email.policy.default)
    assert found["Subject"].startswith("lecombus hall-3: feeder")
    failing = script(tmp_path, "echo queue full >&2; exit 75")
    assert "ended with status 75: queue full" in refusal(SendmailChannel(entry, failing))


def test_the_channels_are_those_of_the_roster() -> None:
    both = NotifyEntry(command=("/bin/page",), mail=mail(25))
    assert [type(one) for one in channels_of(both)] == [CommandChannel, MailServerChannel]
    local = NotifyEntry(
        mail=MailEntry(to=("a@b.example", "c@d.example"), sender="hall-3@example.org")
    )
    assert [type(one) for one in channels_of(local)] == [SendmailChannel]
