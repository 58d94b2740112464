"""A line with fake operations behind the TCP server with tokens, and TLS if wanted."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import anyio
import httpx2

from lecombus.api import Doors, Served, TlsContexts, TokenWatch, serve
from lecombus.roster import TlsEntry
from lecombus.tokens.grants import Scope
from lecombus.tokens.secret import digest_of, new_secret
from lecombus.tokens.token_file import TokenEntry, write_tokens
from support.api_line import Line
from support.certificates import Certificates, client_context

__all__ = ["GuardedDoor", "guarded_door"]


@dataclass
class GuardedDoor:
    """A door and the secrets of its tokens, by name."""

    line: Line
    served: Served
    watch: TokenWatch
    file: Path
    tls: TlsContexts | None
    certificates: Certificates | None
    secrets: dict[str, str] = field(default_factory=dict)
    entries: dict[str, TokenEntry] = field(default_factory=dict)

    @property
    def place(self) -> tuple[str, int]:
        assert self.served.http is not None
        return self.served.http

    @property
    def url(self) -> str:
        scheme = "http" if self.tls is None else "https"
        return f"{scheme}://localhost:{self.place[1]}"

    async def give(
        self, name: str, *scopes: str, targets: tuple[str, ...] = (), ends_in_s: float | None = None
    ) -> str:
        """Make a token that is valid now."""
        secret, now = new_secret(), datetime.now(UTC)
        end = None if ends_in_s is None else now + timedelta(seconds=ends_in_s)
        self.entries[name] = TokenEntry(
            name=name, sha256=digest_of(secret), created=now, expires=end, targets=targets,
            scopes=tuple(map(Scope, scopes)),
        )  # fmt: skip
        self.secrets[name] = secret
        await self._write()
        return secret

    async def revoke(self, name: str) -> None:
        del self.entries[name]
        await self._write()

    async def _write(self) -> None:
        write_tokens(self.file, list(self.entries.values()))
        await self.watch.look()

    @asynccontextmanager
    async def client(
        self, token: str | None = None, *, shows: bool = False
    ) -> AsyncIterator[httpx2.AsyncClient]:
        """Connect as a client with the token of a name."""
        headers = {} if token is None else {"Authorization": f"Bearer {self.secrets[token]}"}
        made = self.certificates
        tls = True if made is None else client_context(made, shows=shows)
        async with httpx2.AsyncClient(
            base_url=self.url, headers=headers, trust_env=False, verify=tls
        ) as client:
            yield client


@asynccontextmanager
async def guarded_door(
    line: Line,
    folder: Path,
    certificates: Certificates | None = None,
    entry: TlsEntry | None = None,
    host: str = "127.0.0.1",
    patience_s: float = 30,
) -> AsyncIterator[GuardedDoor]:
    """Serve a line until the block ends."""
    file = folder / "tokens"
    watch, tls = TokenWatch(file, time.time), None
    if entry is None and certificates is not None:
        entry = certificates.server()
    if entry is not None:
        tls = TlsContexts(entry)
        tls.use(await tls.read())
    doors = Doors(tokens=watch, tls=tls, hosts=("drives.example",))
    async with anyio.create_task_group() as tasks:

        async def run(*, task_status: anyio.abc.TaskStatus[Served]) -> None:
            await serve(line.app, folder / "s", (host, 0), doors=doors, task_status=task_status)

        served = await tasks.start(run)
        tasks.start_soon(line.readers.run)
        with anyio.fail_after(patience_s):
            yield GuardedDoor(line, served, watch, file, tls, certificates)
        tasks.cancel_scope.cancel()
