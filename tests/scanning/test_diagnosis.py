"""What is said of a line on which no drive was found."""

from __future__ import annotations

from lecombus.fieldbus.lecom.protocol.controls import with_parity
from lecombus.fieldbus.lecom.scanning import Unclear, why_nothing
from support.golden import Golden

ANSWER = b"\x0246" + b"35.4" + b"\x03\x1d"


def say(
    samples: list[tuple[int, bytes]] | None = None,
    unclear: list[Unclear] | None = None,
    *,
    echo: bool = False,
    parity: str = "line",
    bauds: tuple[int, ...] = (9600,),
) -> tuple[str, str]:
    return why_nothing(samples or [], unclear or [], echo=echo, parity=parity, bauds=bauds)


def test_nothing_at_all(golden: Golden) -> None:
    what, remedy = say()
    golden(what, remedy)
    assert "--all-bauds" not in say(bauds=(9600, 19200))[1]


def test_only_the_echo() -> None:
    assert "what is sent comes back, so adapter and wire return it" in say(echo=True)[0]


def test_answers_without_parity_where_it_is_expected() -> None:
    what, remedy = say([(11, ANSWER[:1])])  # the rest is not kept
    assert what.startswith("address 11 answers, but no character has the parity expected")
    assert remedy.startswith("try --parity port")


def test_answers_with_parity_where_none_is_expected() -> None:
    assert say([(11, with_parity(ANSWER))], parity="port")[1].startswith("try --parity line")
    assert "leave out --parity port unless" in say(parity="port")[1]


def test_rubbish() -> None:
    what, remedy = say([(11, b"\xff\x00\x81")], [Unclear(11, 9600, b"\xff\x00\x81")])
    assert "when address 11 was asked, but never a whole answer: FF 00 81" in what
    assert "two drives with one address" in remedy
