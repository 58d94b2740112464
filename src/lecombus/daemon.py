"""The daemon: builds everything of one line and runs it. Start reading here.

Order of things. The roster is loaded before anything is opened. Then two task groups, one inside
the other: outside the line (worker, supervisor), inside the interfaces (API, signals, service
manager). The API takes its places before the port is opened: where another daemon has them, its
line is not disturbed. At the end nothing more is written; `on_shutdown` is sent first, in the stop
class: a slow client must not keep a motor running; then the interfaces end with the requests under
way; then the worker ends after its telegram, and the port is closed. The journal is opened first
and closed last. An error in any task ends the daemon, which the service manager starts again: no
error is hidden.

SIGTERM and SIGINT end it. SIGHUP and `POST /v1/reload` read the roster again, in a thread, and
apply it; a wrong one is reported and the old one kept.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import os
import signal
import socket
import sys
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import anyio
import anyio.lowlevel
import anyio.to_thread

from lecombus import __version__
from lecombus.api import (
    Doors,
    EventReaders,
    TlsContexts,
    TlsFileError,
    TokenWatch,
    create_app,
    serve,
)
from lecombus.config import ApiEntry, Mistake, Roster, RosterChanges, RosterError, load_roster
from lecombus.drives import StopAction
from lecombus.errors import LecombusError, LineClosedError, OperationError
from lecombus.fieldbus.port import PortOpener
from lecombus.fieldbus.protocols import find
from lecombus.journal.journal import Journal
from lecombus.journal.journal_file import JournalFileError
from lecombus.journal.kept import KeyRow
from lecombus.line.devices import others_at
from lecombus.line.event_loop import run as run_loop
from lecombus.line.opening import open_port
from lecombus.line_runtime import LineRuntime
from lecombus.operations.actions import ACTOR
from lecombus.operations.operation_reports import GroupReport
from lecombus.saved_state import Keeping
from lecombus.supervision.journal_record import JournalRecord

__all__ = ["SIM_URL", "Daemon", "Notifier", "opener_for", "plain_errors", "run"]

logger = logging.getLogger(__name__)
Signals = AsyncIterator[signal.Signals]

SWITCH_INTERVAL_S = 0.001
"""How long a thread (reloading a roster) may hold the interpreter while the line wants it."""

SHUTDOWN_STOP_S = 8.0
"""How long `on_shutdown` may take before the port is closed all the same."""

TICK_S = 1.0

TOKENS = "tokens"
CERTIFICATE = "certificate"
RELOAD = "reload"
"""Keys of remarks: the file of tokens is not used, a certificate expires, a reload was refused."""


def run(path: Path, *, log_format: str = "logfmt") -> int:
    """Run the line of a roster until SIGTERM or SIGINT.

    Args:
        path: The roster's file.
        log_format: How the log is written; it is set up by the caller.

    Returns:
        Exit status 0.

    Raises:
        RosterError: The roster is wrong; nothing was opened.
        OperationError: The API cannot listen where the roster says.
    """
    roster = load_roster(path)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    with plain_errors():
        run_loop(to_the_end, Daemon(roster, path))
    return 0


async def to_the_end(daemon: Daemon) -> None:
    """Run a daemon; when all is closed, no signal changes how the process ends."""
    await daemon.main()
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def plain_errors() -> Iterator[None]:
    """Raise the error itself instead of the groups that task groups wrap round it.

    Only what lecombus raises on purpose is taken out of its group: anything else is a mistake in
    the program and keeps its whole trace.
    """
    try:
        yield
    except BaseExceptionGroup as group:  # all of it goes on, but for the group
        wanted, rest = group.split(LecombusError)
        if wanted is None or rest is not None:
            raise
        raise first_error(wanted) from None


def first_error(error: BaseException) -> BaseException:
    """Return an error itself, or the first of a group."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error


def log_last_stop(action: StopAction, report: GroupReport) -> None:
    """Log the result of `on_shutdown`; a drive that may still run must be checked by a person."""
    doubtful = ",".join(one.drive for one in report.members if not one.outcome.is_good)
    level, more = (logging.ERROR, f" not-stopped={doubtful}") if doubtful else (logging.INFO, "")
    logger.log(level, "event=shutdown-stop action=%s outcome=%s%s", action, report.outcome, more)


class Daemon:
    """One line with everything round it.

    Args:
        roster: The line and its drives.
        path: Where the roster is read from again at a reload; None: it is not.
    """

    def __init__(self, roster: Roster, path: Path | None) -> None:
        self._roster = roster
        self._path = path
        self._notifier = Notifier()
        self._end = anyio.Event()
        self._reloading = anyio.Lock()
        self._ready = False
        self._looking = False
        self._tokens: TokenWatch | None = None
        self._tls: TlsContexts | None = None
        self._progress = (-1, -1)
        self._progress_at_s = 0.0
        self._ended_by = "an error"
        self._record: JournalRecord | None = None
        self._kept_keys: Sequence[KeyRow] | None = ()
        self.runtime: LineRuntime | None = None

    async def main(self) -> None:
        """Run until a signal or an error ends it; further signals do not cut the end short."""
        with anyio.open_signal_receiver(signal.SIGTERM, signal.SIGINT, signal.SIGHUP) as signals:
            await self._main(signals)
        logger.info("event=stopped line=%s", self._roster.line.name)

    async def _main(self, signals: Signals) -> None:
        """Run between the opening and the closing of what is kept."""
        file = self._roster.state
        keeping = await Keeping.opened(None if file is None else Path(file))
        entry, journal = self._roster.journal, None
        if entry is not None:
            journal = await Journal.opened(Path(entry.file), entry.max_size, time.time)
        try:
            await self._run(keeping, journal, signals)
        except BaseException as exc:  # of any kind: the journal says what ended the daemon
            error = first_error(exc)
            self._ended_by = f"{type(error).__name__}: {error}"
            raise
        finally:
            keeping.close()
            if self._tls is not None:
                self._tls.close()
            if journal is not None:
                with anyio.CancelScope(shield=True):
                    if self._record is not None:
                        self._record.ended_run(self._ended_by)
                    await journal.close()

    async def _run(self, keeping: Keeping, journal: Journal | None, signals: Signals) -> None:
        """Run the line and its interfaces."""
        clock = anyio.current_time
        runtime = self.runtime = LineRuntime(
            self._roster, opener_for(self._roster), clock, time.time, state=keeping.state
        )
        self._progress_at_s = clock()
        logger.info(
            "event=start version=%s line=%s drives=%d",
            __version__, self._roster.line.name, len(self._roster.drives),
        )  # fmt: skip
        if journal is not None:
            await self._record_in(journal, runtime)
            try:
                self._kept_keys = await journal.keys()
            except JournalFileError as exc:
                self._kept_keys = None
                logger.warning("event=keys-not-kept reason=%s", exc)
        async with anyio.create_task_group() as line:
            async with anyio.create_task_group() as interfaces:
                interfaces.start_soon(self._watch_signals, interfaces, signals)
                await self._serve(interfaces, runtime, journal)
                gc.freeze()  # what lives by now lives to the end
                gc.enable()
                line.start_soon(keeping.run, partial(runtime.store.note_line, "state"))
                if journal is not None:
                    line.start_soon(journal.run, partial(runtime.store.note_line, "journal"))
                line.start_soon(runtime.supervision.drives.run)
                line.start_soon(runtime.supervision.leases.run)
                line.start_soon(runtime.worker.run)
                interfaces.start_soon(self._tick, interfaces, runtime)
                await self._end.wait()
                self._notifier.tell("STOPPING=1")
                logger.info("event=stopping line=%s", self._roster.line.name)
                runtime.operations.close()
                await self._stop_at_end(runtime)
                interfaces.cancel_scope.cancel()
            runtime.operations.actions.look(at_end=True)
            runtime.worker.close()
            line.cancel_scope.cancel()

    async def _record_in(self, journal: Journal, runtime: LineRuntime) -> None:
        """Have the journal record what is done on the line and what happens to it."""
        entry = self._roster.journal
        assert entry is not None
        self._record = record = JournalRecord(
            journal, runtime.store, refuses=entry.on_failure == "refuse"
        )
        record.follow(runtime.operations)
        runtime.supervision.watch.journal = journal.figures
        journal.head_logged = lambda head: runtime.events.publish("line", "", {"journal": head})
        await record.started(self._roster, __version__)

    def end(self, why: str = "its owner") -> None:
        """End the daemon in good order; `why` stands in the journal."""
        self._ended_by = why
        self._end.set()

    async def _serve(
        self, interfaces: anyio.abc.TaskGroup, runtime: LineRuntime, journal: Journal | None
    ) -> None:
        api = self._roster.api
        readers = EventReaders(
            runtime.events, runtime.supervision.event_sources.look, anyio.current_time
        )
        interfaces.start_soon(readers.run)
        app = create_app(
            runtime.operations,
            runtime.store,
            runtime.metrics,
            plan_facts=lambda: runtime.supervision.watch.plan_facts(runtime.roster),
            line_name=self._roster.line.name,
            port=self._roster.line.port,
            baud=self._roster.line.baud,
            ready=self.ready,
            healthy=self.healthy,
            reload=self.reload,
            read_only=api.read_only,
            journal=journal,
            kept_keys=self._kept_keys,
            readers=readers,
            version=__version__,
            clock=anyio.current_time,
        )
        http = None if api.http is None else (api.http.host, api.http.port)
        doors = await self._doors(api, runtime)
        for watched in (self._tokens, self._tls):
            if watched is not None:
                interfaces.start_soon(watched.run)
        served = await interfaces.start(partial(serve, doors=doors), app, Path(api.socket), http)
        logger.info("event=serving socket=%s http=%s", served.socket_path, served.address)

    async def _doors(self, api: ApiEntry, runtime: LineRuntime) -> Doors:
        """Read tokens and certificate.

        Raises:
            TlsFileError: The certificate or its key cannot be used.
        """
        if api.tokens is not None:
            note = partial(runtime.store.note_line, TOKENS)
            self._tokens = TokenWatch(Path(api.tokens), time.time, note)
            await self._tokens.look(always=True)
        if api.tls is not None:
            self._tls = tls = TlsContexts(api.tls, partial(runtime.store.note_line, CERTIFICATE))
            tls.use(await tls.read())
            runtime.metrics.certificates = lambda: tls.expires
        return Doors(api.socket_group or "", self._tokens, self._tls, api.hosts)

    # ---- signals and the service manager ----------------------------------------------------

    async def _watch_signals(self, interfaces: anyio.abc.TaskGroup, signals: Signals) -> None:
        async for number in signals:
            if number == signal.SIGHUP:
                interfaces.start_soon(self._reload_by_signal)
            elif not self._end.is_set():
                self.end(signal.Signals(number).name)

    async def _reload_by_signal(self) -> None:
        with contextlib.suppress(LecombusError):  # what is wrong stands in the log
            await self.reload()

    async def reload(self) -> RosterChanges:
        """Read the roster again and apply it; a wrong one changes nothing.

        Two reloads run one after the other.

        Returns:
            What differs from the roster before.

        Raises:
            RosterError: The roster is refused; carries every mistake.
            OperationError: This daemon has no roster file, or it is ending.
        """
        async with self._reloading:
            if self._path is None or self.runtime is None:
                raise OperationError(
                    "this daemon has no roster file to read again",
                    kind="no-roster",
                    remedy="start it with `lecombus run -c ROSTER`",
                )
            self._refuse_at_end()
            was_ready = self._ready
            if was_ready:  # else READY would end the start of a line that is not open yet
                now_us = time.monotonic_ns() // 1000
                self._notifier.tell("RELOADING=1", f"MONOTONIC_USEC={now_us}")
            try:
                return await self._apply_file(self.runtime, self._path)
            finally:
                if was_ready:
                    self._notifier.tell("READY=1")

    def _refuse_at_end(self) -> None:
        """Change no drive while the last stop is sent."""
        if self._end.is_set():
            raise LineClosedError("lecombus is ending; the roster is not read again")

    async def _apply_file(self, runtime: LineRuntime, path: Path) -> RosterChanges:
        """Read a roster in a thread and apply it; log how that ended, and who asked for it."""
        who = " ".join(f"{key}={text}" for key, text in ACTOR.get().fields().items())
        running = runtime.roster
        try:
            roster = await anyio.to_thread.run_sync(
                load_roster, path, running, abandon_on_cancel=True
            )
            tls = None if self._tls is None else await self._tls.read()
            self._refuse_at_end()
            changes = runtime.apply(roster)
        except TlsFileError as exc:
            wrong = RosterError([Mistake(exc.file, 1, 1, exc.what, exc.remedy)])
            self._refuse_reload(runtime, wrong, who)
            raise wrong from exc
        except RosterError as exc:
            self._refuse_reload(runtime, exc, who)
            raise
        if self._tls is not None and tls is not None:
            self._tls.use(tls)
        if self._tokens is not None:
            await self._tokens.look(always=True)
        self._roster = roster
        runtime.store.note_line(RELOAD, None)
        logger.info("event=reloaded drives=%d %s %s", len(roster.drives), changes, who)
        if self._record is not None:
            await self._record.reloaded(running, roster)
        return changes

    def _refuse_reload(self, runtime: LineRuntime, refused: RosterError, who: str) -> None:
        """Say that the old roster stays, in the log and until a reload is good."""
        for mistake in refused.mistakes:
            logger.error("event=reload-refused %s mistake=%s", who, mistake)
        more, count = "", len(refused.mistakes)
        if count > 1:
            more = f" (and {count - 1} more: `lecombus reload` lists them)"
        if self._record is not None:
            self._record.reload_refused(refused)
        first = refused.mistakes[0]
        text = f"the last reload was refused, the old roster is used: {first}{more}"
        runtime.store.note_line(RELOAD, text)

    async def _tick(self, interfaces: anyio.abc.TaskGroup, runtime: LineRuntime) -> None:
        """Report to the service manager, and update the store, once a second."""
        while True:
            runtime.supervision.watch.look()
            if not self._looking and runtime.supervision.watch.wants_look_at_port():
                self._looking = True
                interfaces.start_soon(self._look_at_port, runtime)
            if not self._ready and runtime.tried_all():
                self._ready = True
                self._notifier.tell("READY=1", f"STATUS=line {self._roster.line.name} is open")
                logger.info("event=ready line=%s", self._roster.line.name)
                # What lives by now lives to the end. Collecting it took 76 ms, with 31 drives, in
                # which no telegram went out.
                gc.freeze()
            if self.healthy()[0]:
                self._notifier.tell(PING)
            await anyio.sleep(TICK_S if self._ready else TICK_S / 10.0)

    async def _look_at_port(self, runtime: LineRuntime) -> None:
        """Look who else has the port open, beside the line."""
        port = self._roster.line.port
        try:
            runtime.supervision.watch.port.found(
                await anyio.to_thread.run_sync(others_at, port, abandon_on_cancel=True)
            )
        finally:
            self._looking = False

    def ready(self) -> tuple[bool, str]:
        """Whether the line is open and every drive has been tried once."""
        if self.runtime is None or not self.runtime.worker.is_open:
            reason = self.runtime.store.line().reason if self.runtime is not None else ""
            return False, f"the line is not open: {reason}"
        if not self.runtime.tried_all():
            return False, "not every drive has been tried yet"
        return True, "the line is open and every drive has been tried"

    def healthy(self) -> tuple[bool, str]:
        """Whether the line task makes progress; systemd's watchdog hangs on this."""
        if self.runtime is None:
            return False, "not started"
        now = anyio.current_time()
        worker = self.runtime.worker
        progress = (worker.exchanges, worker.rests)
        if progress != self._progress:
            self._progress, self._progress_at_s = progress, now
        still_s = now - self._progress_at_s
        if still_s > self.runtime.longest_exchange_s:
            return False, f"the line task has made no progress for {still_s:.1f} s"
        return True, f"{worker.exchanges} exchanges so far"

    async def _stop_at_end(self, runtime: LineRuntime) -> None:
        """Do to the drives what the roster wants done at the end."""
        wanted = runtime.roster.on_shutdown
        if wanted == "nothing":
            return
        action = StopAction(wanted)
        with anyio.move_on_after(SHUTDOWN_STOP_S) as scope:
            try:
                if not runtime.worker.is_open:
                    raise LineClosedError(f"the line is not open: {runtime.store.line().reason}")
                report = await runtime.operations.stop(action, "all")
            except LecombusError as exc:
                logger.error("event=shutdown-stop-failed action=%s reason=%s", action, exc)
            else:
                log_last_stop(action, report)
        if scope.cancelled_caught:
            logger.error("event=shutdown-stop-failed action=%s reason=too slow", action)


PING: Final = "WATCHDOG=1"
UNSENT_MOST: Final = 8
"""Messages that wait for a service manager; more than a start, a reload and an end need."""


class Notifier:
    """Sends states to the service manager; does nothing where there is none.

    The protocol is one datagram to the socket named in NOTIFY_SOCKET (sd_notify(3)). It is twenty
    lines here because the Python bindings for it are either unmaintained or need a compiler and
    LGPL headers on the user's machine.

    A manager that does not read must not hold the line up: nothing here waits. What could not be
    sent goes before the next states, but for pings: a late one would speak of a line of before.
    """

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._unsent: list[str] = []

    def tell(self, *states: str) -> None:
        """Send states such as `READY=1`; errors are ignored."""
        if not self._address:
            return
        waiting = [*self._unsent, "\n".join(states)]
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, kind) as sock:
            sock.connect(self._address)
            while waiting:
                sock.send(waiting[0].encode())
                del waiting[0]
        self._unsent = [one for one in waiting if one != PING][-UNSENT_MOST:]


SIM_URL: Final = "sim:"


def opener_for(roster: Roster) -> PortOpener:
    """Give what opens the roster's port: a real one, or `sim:`, its own drives simulated here.

    The simulator is the protocol's, and loaded where it is used: a daemon that starts again has
    watchdogs to feed.
    """
    if roster.line.port != SIM_URL:
        return open_port
    return find(roster.line.protocol).simulator(roster)
