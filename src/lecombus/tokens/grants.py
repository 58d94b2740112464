"""What a request may do: scopes, and the drives that they hold for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

__all__ = ["ALL_DRIVES", "EVERYTHING", "NOTHING", "Grant", "Scope", "granted"]

ALL_DRIVES: Final = "all"
"""The target that stands for all drives, also those that the roster gets later."""


class Scope(StrEnum):
    """What a token is for. `read` includes `metrics`; `write` and `control` include `read`."""

    METRICS = "metrics"
    READ = "read"
    WRITE = "write"
    CONTROL = "control"


INCLUDED: Final[Mapping[Scope, frozenset[Scope]]] = {
    Scope.METRICS: frozenset({Scope.METRICS}),
    Scope.READ: frozenset({Scope.METRICS, Scope.READ}),
    Scope.WRITE: frozenset({Scope.METRICS, Scope.READ, Scope.WRITE}),
    Scope.CONTROL: frozenset({Scope.METRICS, Scope.READ, Scope.CONTROL}),
}


@dataclass(frozen=True, slots=True)
class Grant:
    """What a request may do; by default nothing.

    Args:
        scopes: What it may do, included scopes as well.
        targets: Drives and groups that it may see and move; None: every drive, and the line.
    """

    scopes: frozenset[Scope] = frozenset()
    targets: frozenset[str] | None = frozenset()

    @property
    def is_whole(self) -> bool:
        """Whether it holds for every drive and for the line."""
        return self.targets is None

    def reaches(self, drives: Iterable[str], groups: Mapping[str, Iterable[str]]) -> bool:
        """Return whether it holds for all of some drives.

        Args:
            drives: Their names.
            groups: The members of the roster's groups.
        """
        if self.targets is None:
            return True
        reached = set(self.targets)
        for name in self.targets:
            reached.update(groups.get(name, ()))
        return reached.issuperset(drives)


NOTHING: Final = Grant()
EVERYTHING: Final = Grant(frozenset(Scope), None)


def granted(scopes: Iterable[Scope], targets: Iterable[str] = ()) -> Grant:
    """Return what scopes allow.

    Args:
        scopes: The scopes.
        targets: Drives and groups; none, or `all`: every drive.
    """
    names = frozenset(targets)
    allowed = frozenset[Scope]().union(*(INCLUDED[scope] for scope in scopes))
    return Grant(allowed, None if not names or ALL_DRIVES in names else names)
