"""What a body can make the daemon do is bounded: counted in calls, never in seconds."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from lecombus.api import decimal_json, request_checks, request_models
from lecombus.api.answers import RefusedRequestError
from lecombus.api.limits import BODY_LIMIT
from lecombus.api.request_models import (
    AcceptBody,
    Body,
    DriveWriteBody,
    LeaseBody,
    SpeedBody,
    StopBody,
    WaitingBody,
)

MODELS = (DriveWriteBody, StopBody, SpeedBody, AcceptBody)


def bodies(model: type[Body]) -> list[type[Body]]:
    """All models of bodies that are sent: `WaitingBody` is only what others have in common."""
    found = [one for part in model.__subclasses__() for one in (part, *bodies(part))]
    return [one for one in found if one is not WaitingBody]


def many(row: str) -> bytes:
    """An object as full of rows as a body can be."""
    rows = (row % number for number in range(BODY_LIMIT // (len(row) + 3)))
    return f"{{{','.join(rows)}}}".encode()


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often what costs most was called."""
    counts: Counter[str] = Counter()

    def count(name: str) -> None:
        plain = getattr(request_checks, name)

        def counted(*args: Any, **more: Any) -> Any:
            counts[name] += 1
            return plain(*args, **more)

        monkeypatch.setattr(request_checks, name, counted)

    count("get_close_matches")
    count("mistake_text")
    return counts


def said_of(raw: bytes, model: type[Body]) -> str:
    with pytest.raises(RefusedRequestError) as caught:
        request_checks.checked(request_checks.object_of(raw, model), model)
    return caught.value.problem.detail


@pytest.mark.parametrize("model", bodies(Body))
def test_the_example_that_a_refusal_gives_is_taken(model: type[Body]) -> None:
    for example in model.example.split(", or "):
        request_checks.checked(request_checks.object_of(example.encode(), model), model)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("row", ['"valu%x":1', '"%d":null', '"expire%d":true'])
def test_near_matches_are_sought_for_no_more_keys_than_are_told(
    calls: Counter[str], model: type[Body], row: str
) -> None:
    said = said_of(many(row), model)
    assert calls["get_close_matches"] <= request_checks.MISTAKES_LIMIT
    assert calls["mistake_text"] <= len(model.model_fields)
    assert said.endswith(" more")
    assert len(said) < 1500


def test_superfluous_keys_of_a_stop_are_cut_first(calls: Counter[str]) -> None:
    raw = many('"targe%d":1')
    given = request_checks.object_of(raw, StopBody, request_checks.stop_texts)
    told = request_checks.superfluous(given)
    assert calls["get_close_matches"] == request_checks.MISTAKES_LIMIT
    assert len(told) == request_checks.MISTAKES_LIMIT + 1
    assert told[-1] == f"and {len(given) - request_checks.MISTAKES_LIMIT} more"


def test_no_near_match_is_sought_for_a_word_that_nobody_misspelt(calls: Counter[str]) -> None:
    said = said_of(b'{"%s": 1}' % (b"value" * 1000), DriveWriteBody)
    assert calls["get_close_matches"] == 0
    assert "there is no key valuevalue" in said


def test_an_identity_of_thousands_of_codes_is_refused_before_they_are_looked_at(
    calls: Counter[str],
) -> None:
    raw = b'{"identity": %s}' % many('"C%04d":1')
    assert "identity takes what the drive said of itself" in said_of(raw, AcceptBody)
    assert calls["mistake_text"] == 1


@pytest.mark.parametrize(
    ("targets", "said"),
    [
        ("[]", "an empty array"),
        ("[5]", "an array with 5"),
        ('["a", null]', "an array with null"),
        ("[" + ",".join(['"a"'] * 101) + "]", "an array of 101"),
        ('"a"', "'a'"),
    ],
)
def test_a_wrong_list_of_targets_is_said_by_what_is_wrong_with_it(targets: str, said: str) -> None:
    text = said_of(b'{"counter": 1, "time": "2s", "targets": %s}' % targets.encode(), LeaseBody)
    assert text == f"targets takes a list of 1 to 100 names of drives and groups, not {said}"


@pytest.mark.parametrize("number", ["9" * 129, "-" + "9" * 128, "1." + "9" * 127, "0e" + "0" * 127])
def test_a_number_of_many_digits_is_refused_before_it_is_made(number: str) -> None:
    with pytest.raises(decimal_json.NotJsonError, match="more than 128 characters"):
        decimal_json.decode(f'{{"value": {number}}}'.encode())


def test_a_number_of_the_most_digits_is_read() -> None:
    assert decimal_json.decode(b"9" * decimal_json.NUMBER_CHARS) == int(
        "9" * decimal_json.NUMBER_CHARS
    )


def test_keys_that_stand_twice_deep_in_a_stop_are_not_looked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counted: list[int] = []
    plain = decimal_json.repeated

    def repeated(pairs: list[tuple[str, object]]) -> list[str]:
        counted.append(len(pairs))
        return plain(pairs)

    monkeypatch.setattr(decimal_json, "repeated", repeated)
    inner = ",".join('{"a":1,"a":1}' for _ in range(100))
    text = f'{{"action": "inhibit", "target": "all", "k": [{inner}], "k": 1}}'
    decimal_json.decode_texts(text.encode(), ("action", "target"))
    assert counted == [4]


def test_a_duration_is_looked_at_only_if_it_can_be_one() -> None:
    with pytest.raises(ValueError, match="a duration such as"):
        request_models.seconds_of("1" * 5000 + "s")
