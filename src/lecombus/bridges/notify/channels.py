"""How a message leaves: a command, a mail server, or this computer's sendmail.

Each channel has a time limit and says in words why a message was not sent. A command is run without
a shell, in a session of its own that is killed as a whole when it ends or its time is over; it gets
the message as JSON on its standard input and a few plain variables, and nothing else of our
environment. What a command or a server says is shortened before it is logged, and a password in it
is left out.
"""

from __future__ import annotations

import json
import os
import signal
import ssl
import stat
from contextlib import suppress
from email.message import EmailMessage
from email.utils import format_datetime, make_msgid
from pathlib import Path
from subprocess import DEVNULL, PIPE
from typing import Final, Protocol

import anyio
import anyio.abc

from lecombus.bridges.notify.messages import Notification, clean, local
from lecombus.roster import MailEntry, NotifyEntry

__all__ = ["Channel", "CommandChannel", "MailServerChannel", "NotSentError", "channels_of"]

MAIL_WITHIN_S: Final = 60.0
SENDMAIL: Final = "/usr/sbin/sendmail"
WHY_CHARS: Final = 300
OUTPUT_BYTES: Final = 4096
PORTS: Final = {"starttls": 587, "tls": 465, "none": 25}
SHOWN_DRIVES: Final = 50
TEXT_CHARS: Final = 10_000
"""Of the text in the environment, which the system limits; standard input has all of it."""

END_WITHIN_S: Final = 5.0
LEFTOVERS_S: Final = 0.2
"""How long a command is still listened to after its end, if something that it started runs on."""


class NotSentError(Exception):
    """A message was not sent; the text says why."""


class Channel(Protocol):
    """A way to people.

    Attributes:
        name: What the log calls it.
    """

    name: str

    async def send(self, message: Notification) -> None:
        """Send a message.

        Raises:
            NotSentError: It was not sent, or that is not known.
        """


class CommandChannel:
    """Runs a command for each message.

    Args:
        words: The program and its arguments.
        time_s: How long it may run.
    """

    name = "command"

    def __init__(self, words: tuple[str, ...], time_s: float) -> None:
        self._words = words
        self._time_s = time_s

    async def send(self, message: Notification) -> None:
        """Run the command; an exit status of 0 says that the message was sent."""
        document = json.dumps(message.as_json(), ensure_ascii=False, default=str)
        await run_program(self._words, document.encode(), self._time_s, variables(message))


class SendmailChannel:
    """Hands messages to this computer's sendmail.

    Args:
        entry: Sender and receivers.
        program: Its path.
    """

    name = "mail"

    def __init__(self, entry: MailEntry, program: str = SENDMAIL) -> None:
        self._entry = entry
        self._program = program

    async def send(self, message: Notification) -> None:
        """Give the mail to sendmail; it delivers it when it can."""
        words = (self._program, "-i", "-f", self._entry.sender, "--", *self._entry.to)
        mail = mail_of(message, self._entry).as_bytes()
        await run_program(words, mail, MAIL_WITHIN_S, {})


class MailServerChannel:
    """Gives messages to a mail server.

    Args:
        entry: The server, sender and receivers.
    """

    name = "mail"

    def __init__(self, entry: MailEntry) -> None:
        self._entry = entry

    async def send(self, message: Notification) -> None:
        """Send the mail; a receiver that the server refuses is a mail that was not sent to it."""
        try:
            import aiosmtplib
        except ModuleNotFoundError as exc:
            raise NotSentError("aiosmtplib is not installed: install lecombus[notify]") from exc

        entry, password = self._entry, None
        if entry.password_file is not None:
            password = await anyio.to_thread.run_sync(read_password, entry.password_file)
        try:
            with anyio.fail_after(MAIL_WITHIN_S):
                refused, _ = await aiosmtplib.send(
                    mail_of(message, entry), sender=entry.sender, recipients=list(entry.to),
                    hostname=entry.host, port=entry.port or PORTS[entry.security],
                    username=entry.user, password=password, timeout=MAIL_WITHIN_S,
                    use_tls=entry.security == "tls", start_tls=entry.security == "starttls",
                    tls_context=None if entry.security == "none" else trust(entry.ca),
                )  # fmt: skip
        except (aiosmtplib.SMTPException, OSError, ssl.SSLError, TimeoutError) as exc:
            raise NotSentError(
                short(f"{entry.host}: {type(exc).__name__} {exc}", password)
            ) from exc
        if refused:
            whom = ", ".join(f"{to}: {why.code} {why.message}" for to, why in refused.items())
            raise NotSentError(short(f"{entry.host} refused {whom}", password))


def channels_of(entry: NotifyEntry) -> list[Channel]:
    """Return the channels that a roster names."""
    found: list[Channel] = []
    if entry.command:
        found.append(CommandChannel(entry.command, entry.command_time_s))
    if entry.mail is not None:
        sends = SendmailChannel if entry.mail.host is None else MailServerChannel
        found.append(sends(entry.mail))
    return found


def variables(message: Notification) -> dict[str, str]:
    """Return what a command finds in its environment, for simple scripts."""
    drives = sorted({entry.drive for entry in message.entries if entry.drive})
    events = dict.fromkeys(entry.event for entry in message.entries)
    return {
        "LECOMBUS_LINE": message.line,
        "LECOMBUS_SUBJECT": message.subject,
        "LECOMBUS_TEXT": message.text[:TEXT_CHARS],
        "LECOMBUS_EVENTS": ",".join(events),
        "LECOMBUS_DRIVES": ",".join(drives[:SHOWN_DRIVES]),
        "LECOMBUS_ACTIVE": str(sum(entry.active for entry in message.entries)),
        "LECOMBUS_TEST": "1" if message.is_test else "0",
    }


def mail_of(message: Notification, entry: MailEntry) -> EmailMessage:
    """Return a message as a mail."""
    mail = EmailMessage()
    mail["From"] = entry.sender
    mail["To"] = ", ".join(entry.to)
    mail["Subject"] = f"lecombus {message.subject}"
    mail["Date"] = format_datetime(local(message.made_s))
    mail["Message-ID"] = make_msgid(domain=entry.sender.partition("@")[2])
    mail["Auto-Submitted"] = "auto-generated"  # RFC 3834: no vacation answers
    mail.set_content(message.text)
    return mail


def read_password(path: str) -> str:
    """Return the password in a file.

    Raises:
        NotSentError: It cannot be read, is empty, or all users of this computer may read it.
    """
    try:
        with Path(path).open(encoding="utf-8") as file:
            is_open_to_all = os.fstat(file.fileno()).st_mode & stat.S_IROTH
            text = file.read(4096).removesuffix("\n")
    except (OSError, UnicodeDecodeError) as exc:
        why = exc.strerror if isinstance(exc, OSError) else "it is not text"
        raise NotSentError(f"the password file {path} cannot be read: {why}") from exc
    if is_open_to_all:
        raise NotSentError(f"all users may read the password file {path}: chmod o= {path}")
    if not text:
        raise NotSentError(f"the password file {path} is empty")
    return text


def trust(ca: str | None) -> ssl.SSLContext:
    """Return what a mail server's certificate is checked against.

    Raises:
        NotSentError: The file of authorities cannot be read.
    """
    try:
        return ssl.create_default_context(cafile=ca)
    except (OSError, ssl.SSLError) as exc:
        raise NotSentError(f"the authorities in {ca} cannot be read: {exc}") from exc


async def run_program(
    words: tuple[str, ...], given: bytes, time_s: float, extra: dict[str, str]
) -> None:
    """Run a program to its end.

    Args:
        words: The program and its arguments.
        given: Its standard input.
        time_s: How long it may run.
        extra: Its environment, besides `PATH` and the language.

    Raises:
        NotSentError: It cannot be started, runs too long, or ends with another status than 0.
    """
    kept = {key: os.environ[key] for key in ("PATH", "LANG", "TZ") if key in os.environ}
    try:
        program = await anyio.open_process(
            words, stdin=PIPE, stdout=DEVNULL, stderr=PIPE, env={**kept, **extra}, cwd="/",
            start_new_session=True,
        )  # fmt: skip
    except OSError as exc:
        raise NotSentError(f"{words[0]} cannot be started: {exc.strerror or exc}") from exc
    said = bytearray()
    status: int | None = None
    try:
        with anyio.move_on_after(time_s):
            async with anyio.create_task_group() as tasks:
                tasks.start_soon(give, program, given)
                tasks.start_soon(hear, program, said)
                status = await program.wait()
                tasks.cancel_scope.deadline = anyio.current_time() + LEFTOVERS_S
    finally:
        with suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
        with anyio.move_on_after(END_WITHIN_S, shield=True):
            await program.aclose()
    text = short(said.decode(errors="replace"))
    if status is None:
        raise NotSentError(f"{words[0]} did not end within {time_s:g} s: {text}".rstrip(": "))
    if status != 0:
        raise NotSentError(f"{words[0]} ended with status {status}: {text}".rstrip(": "))


async def give(program: anyio.abc.Process, given: bytes) -> None:
    """Write the standard input of a program, which need not read it."""
    assert program.stdin is not None
    with suppress(anyio.BrokenResourceError, anyio.ClosedResourceError, ConnectionError):
        await program.stdin.send(given)
        await program.stdin.aclose()


async def hear(program: anyio.abc.Process, said: bytearray) -> None:
    """Read what a program says, and keep the beginning of it."""
    assert program.stderr is not None
    with suppress(anyio.BrokenResourceError, anyio.ClosedResourceError):
        async for part in program.stderr:
            said += part[: max(0, OUTPUT_BYTES - len(said))]


def short(text: str, secret: str | None = None) -> str:
    """Return a text for the log: one line, not long, without a password."""
    if secret:
        text = text.replace(secret, "***")
    text = " ".join(clean(text).split())
    return text if len(text) <= WHY_CHARS else f"{text[:WHY_CHARS]}.."
