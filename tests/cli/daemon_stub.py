"""A daemon reduced to its answers: an HTTP server on a Unix socket with a table of documents."""

from __future__ import annotations

import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler
from pathlib import Path

__all__ = ["DaemonStub", "serve_stub"]


@dataclass
class DaemonStub:
    """What is answered, and what was asked.

    Args:
        answers: By method and path with query: HTTP status and text. A text of None ends the
            connection without an answer.
        asked: Method, path and body of every request.
    """

    path: Path
    answers: dict[str, tuple[int, str | None]] = field(default_factory=dict)
    asked: list[tuple[str, str]] = field(default_factory=list)


@contextmanager
def serve_stub(path: Path) -> Iterator[DaemonStub]:
    """Serve on a Unix socket until the end of the block."""
    stub = DaemonStub(path)

    class Handler(BaseHTTPRequestHandler):
        def answer(self) -> None:
            body = self.rfile.read(int(self.headers.get("content-length") or 0)).decode()
            asked = f"{self.command} {self.path}"
            stub.asked.append((asked, body))
            status, text = stub.answers.get(asked, (404, '{"title": "no such path"}'))
            if text is None:
                self.close_connection = True
                return
            self.send_response(status)
            is_stream = self.headers.get("accept") == "text/event-stream" and status == 200
            kind = "text/event-stream" if is_stream else "application/json"
            self.send_header("content-type", kind)
            self.send_header("content-length", str(len(text.encode())))
            self.end_headers()
            self.wfile.write(text.encode())

        do_GET = do_PUT = do_POST = do_DELETE = answer  # noqa: N815

        def address_string(self) -> str:
            return "cli"

        def log_message(self, format: str, *args: object) -> None:
            """The tests look at `asked` instead."""

    server = socketserver.ThreadingUnixStreamServer(str(path), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield stub
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
