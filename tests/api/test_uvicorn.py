"""What `HttpConnection` takes from uvicorn and httptools, private names included, is there.

A limit whose hook uvicorn no longer calls would fail without a word. So the versions are bound, and
every name that the connections use or override is looked up in uvicorn's own source.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
import tomllib
from importlib.metadata import version
from pathlib import Path

import httptools
import pytest
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle
from uvicorn.server import Server

from lecombus.api.connection import HttpConnection, PatientFlow
from lecombus.api.server import TcpServer
from lecombus.api.tcp_connection import TcpConnection
from lecombus.api.tls_connection import TlsConnection

OURS = (HttpConnection, TcpConnection, TlsConnection)
CYCLES = {"cycle", "running", "last"}
"""The local names under which a connection has a request that is being answered."""


def tree_of(cls: type) -> ast.Module:
    return ast.parse(textwrap.dedent(inspect.getsource(cls)))


def attributes(tree: ast.AST, of: set[str], kind: type[ast.expr_context]) -> set[str]:
    return {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, kind)
        and isinstance(node.value, ast.Name)
        and node.value.id in of
    }


def has(cls: type) -> set[str]:
    """The attributes of a class and of its instances."""
    return set(dir(cls)) | attributes(tree_of(cls), {"self"}, ast.Store)


def calls(cls: type, method: str) -> set[str]:
    """The methods of its own that a method calls."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(getattr(cls, method))))
    return attributes(tree, {"self"}, ast.Load)


@pytest.mark.parametrize(("package", "release"), [("uvicorn", "0.54"), ("httptools", "0.9")])
def test_the_versions_are_bound(package: str, release: str) -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    assert f"{package}~={release}.0" in project["project"]["dependencies"]
    assert version(package).startswith(f"{release}.")


@pytest.mark.parametrize("cls", OURS)
def test_every_name_that_a_connection_uses_exists(cls: type[HttpConnection]) -> None:
    own = {name for one in OURS for name in vars(one)} | {
        name for one in OURS for name in one.__annotations__
    }
    own |= {
        name
        for one in OURS
        for name in attributes(tree_of(one), {"self"}, ast.Store)
        if name.startswith("_")
    }
    used = attributes(tree_of(cls), {"self"}, ast.Load) - own
    assert {"parser", "cycle", "pipeline", "headers", "url"} & used or cls is not HttpConnection
    assert used - has(HttpToolsProtocol) == set()
    replaced = attributes(tree_of(cls), {"self"}, ast.Store)
    assert {name for name in replaced - own if not name.startswith("_")} <= has(HttpToolsProtocol)


@pytest.mark.parametrize("cls", OURS)
def test_every_name_of_a_request_that_a_connection_uses_exists(cls: type[HttpConnection]) -> None:
    tree = tree_of(cls)
    used = attributes(tree, CYCLES, ast.Load) | attributes(tree, CYCLES, ast.Store)
    assert "response_complete" in used or cls is not HttpConnection
    assert used - has(RequestResponseCycle) == set()


@pytest.mark.parametrize("cls", OURS)
def test_what_a_connection_overrides_has_the_same_parameters(cls: type[HttpConnection]) -> None:
    overridden = {name for name in vars(cls) if name in vars(HttpToolsProtocol)} - {"__module__"}
    methods = {name for name in overridden if inspect.isfunction(vars(cls)[name])}
    assert "_start_asgi_task" in methods or cls is TlsConnection
    for name in methods:
        ours = inspect.signature(getattr(cls, name)).parameters
        theirs = inspect.signature(getattr(HttpToolsProtocol, name)).parameters
        assert list(ours) == list(theirs), name


@pytest.mark.parametrize(
    ("by", "called"),
    [
        ("on_headers_complete", {"_start_asgi_task", "on_response_complete", "flow", "pipeline"}),
        ("on_response_complete", {"_start_asgi_task", "_unset_keepalive_if_required", "flow"}),
        ("connection_lost", {"_unset_keepalive_if_required", "cycle"}),
        ("on_message_begin", {"app_state", "headers"}),
        ("_start_asgi_task", {"tasks", "loop"}),
    ],
)
def test_uvicorn_goes_through_what_is_overridden(by: str, called: set[str]) -> None:
    assert called <= calls(HttpToolsProtocol, by)


def test_uvicorn_reads_on_by_the_call_that_is_overridden() -> None:
    assert "resume_reading" in vars(FlowControl)
    assert "resume_reading" in vars(PatientFlow)
    source = inspect.getsource(HttpToolsProtocol.on_response_complete)
    assert "self.flow.resume_reading()" in source


def test_the_parser_has_the_calls_that_a_connection_makes() -> None:
    parser = httptools.HttpRequestParser(object())
    for name in (
        "feed_data", "get_http_version", "get_method", "should_keep_alive", "should_upgrade",
        "set_dangerous_leniencies",
    ):  # fmt: skip
        assert callable(getattr(parser, name)), name


@pytest.mark.parametrize("name", ["startup", "shutdown", "capture_signals"])
def test_what_a_server_overrides_is_called_and_has_the_same_parameters(name: str) -> None:
    ours = inspect.signature(getattr(TcpServer, name)).parameters
    assert list(ours) == list(inspect.signature(getattr(Server, name)).parameters)
    assert name in calls(Server, "serve") | calls(Server, "_serve")


def test_uvicorn_makes_a_connection_as_our_listener_does() -> None:
    used = attributes(tree_of(TcpServer), {"self"}, ast.Load) - set(vars(TcpServer))
    used = {name for name in used if not name.startswith("_")}
    assert used == {"config", "server_state", "lifespan"}
    assert used <= has(Server)
    startup = inspect.getsource(Server.startup)
    for given in (
        "config=config", "server_state=self.server_state", "app_state=self.lifespan.state",
        "if sockets is not None",
    ):  # fmt: skip
        assert given in startup
    assert {"config", "server_state", "app_state"} <= set(
        inspect.signature(HttpToolsProtocol).parameters
    )
