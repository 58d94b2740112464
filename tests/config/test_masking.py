"""Secrets of rosters and documents: none is left, and what is not a secret stays."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from config.rosters import CONFIG, GOOD, parsed
from lecombus.config import load_roster, parse_roster
from lecombus.config.masking import MASK, Masker, mask_roster

SECRET = "hunter2-hunter2"


@pytest.mark.parametrize("written", [
    f"password: {SECRET}",
    f"password: '{SECRET}'",
    f'mail: {{"password": "{SECRET}"}}',
    f"mqtt: {{host: b, passwd: {SECRET}}}",
    f"api_key: &a {SECRET}",
    f"token: !x {SECRET}",
    f"secret: [{SECRET}, {{a: {SECRET}}}]",
    f"credentials:\n  - {SECRET}\n  - deep:\n      er: {SECRET}",
    f"passphrase: |\n  {SECRET}\n  {SECRET}",
    f"tls:\n  key: >-\n    {SECRET}",
    f"? password\n: {SECRET}",
    f"drives:\n  - name: a\n    identity: {{C0094: {SECRET}}}",
    f"drives: [{{identity: {{P194: {SECRET}}}}}]",
    f"notify: {{command: [/usr/bin/curl, -H, {SECRET}]}}",
    f"notify:\n  command:\n    - /usr/bin/curl\n    - {SECRET}",
    f"notify: {{comand: [/usr/bin/curl, -H, {SECRET}]}}",
    f"mqtt: {{host: b, username: u, password_file: {SECRET}}}",
    f"notify:\n  mail:\n    password-file: '{SECRET}'",
    f"mqtt: {{host: b, pw: {SECRET}}}",
    f"mqtt: {{host: b, Passwort: {SECRET}}}",
    f"line: {{name: a}}  # {SECRET}",
    f"# {SECRET}\nline: {{name: a}}\n#{SECRET}",
    f"{SECRET[:0]}password: {SECRET}\nother: [unclosed",
])  # fmt: skip
def test_no_secret_is_left_in_a_roster(written: str) -> None:
    for text in (written, f"first: 1\n{written}", f"{written}\nlast: 2", f"\ufeff{written}\n"):
        masked = mask_roster(text)
        assert masked is None or SECRET not in masked.text


def test_what_is_no_secret_stays_as_it_is_and_can_be_read_again() -> None:
    text = GOOD + "mqtt: {host: b, password_file: /etc/p, key: /etc/k, certificate: /etc/c}\n"
    text += "api: {tokens: /etc/lecombus/tokens, http: '127.0.0.1:97#40'}\n"
    masked = mask_roster(text)
    assert masked is not None
    assert (masked.text, masked.secrets) == (text, frozenset())


def test_the_roster_with_every_key_means_the_same_without_its_comments() -> None:
    path = CONFIG / "full.yaml"
    masked = mask_roster(path.read_text(encoding="utf-8"))
    assert masked is not None
    assert "#" not in masked.text
    found = parse_roster(masked.text, str(path))
    whole = load_roster(path)
    if found.notify is not None and found.notify.command is not None:
        assert set(found.notify.command[1:]) == {MASK}
        found = found.model_copy(update={"notify": whole.notify})
    assert found == whole


def test_of_a_text_that_is_no_yaml_nothing_is_given() -> None:
    assert mask_roster(f'a: "{SECRET}') is None
    assert mask_roster("a: \x00") is None


@given(st.text(alphabet="abps:#{}[],'\"\n -|>&*!%@?", max_size=60))
def test_any_text_is_masked_or_left_out(text: str) -> None:
    masked = mask_roster(f"{text}\npassword: {SECRET}\n")
    assert masked is None or SECRET not in masked.text


def test_what_was_masked_is_masked_everywhere_and_short_ones_are_not() -> None:
    masker = Masker({SECRET, "a"})
    assert masker.text(f"`{SECRET}` is not a port, a") == f"`{MASK}` is not a port, a"


@pytest.mark.parametrize("text", [
    "lcb_0123456789abcdef", "Authorization: Bearer abcdefg", "https://me:abcdefg@host/x",
    "1795431127001-6e3f0a6e3f0a6e3f0a6e3f0a6e3f0a11",
    "-----BEGIN EC PRIVATE KEY-----\nabcdefg\n-----END EC PRIVATE KEY-----",
    "-----BEGIN PRIVATE KEY-----\nabcdefg",
])  # fmt: skip
def test_what_looks_like_a_secret_is_masked_in_every_text(text: str) -> None:
    found = Masker().text(f"before {text} after")
    assert found.startswith("before ")
    assert not {"abcdefg", "0123456789", "6e3f0a"} & set(found.replace("@", " ").split())
    assert "abcdefg" not in found
    assert "6e3f0a" not in found
    assert "lcb_" not in found


def test_values_of_passwords_of_drives_are_masked_in_documents_and_metrics() -> None:
    document = {"drives": [{"drive": "a", "values": [
        {"code": "C0094", "subcode": 0, "value": 4711, "raw": "4711", "text": "x", "age_s": 1},
        {"code": "C0050", "value": 35.4, "raw": "35.4"},
    ]}], "rows": [{"fields": {"code": "C94", "value": "4711", "old": "1"}}], "C1194": "4711",
        "Code": "C0094"}  # fmt: skip
    found = Masker().document(document)
    assert "4711" not in str(found)
    assert found["drives"][0]["values"][1] == {"code": "C0050", "value": 35.4, "raw": "35.4"}
    page = 'a_value{drive="a",code="C0094",unit=""} 4711\na_value{drive="a",code="C0050"} 4711\n'
    assert Masker().text(page) == (
        f'a_value{{drive="a",code="C0094",unit=""}} {MASK}\n'
        'a_value{drive="a",code="C0050"} 4711\n'
    )


def test_the_words_of_commands_are_masked_in_rows_of_the_journal() -> None:
    """Rows that were written before lecombus left the words out."""
    row = {"what": "roster", "fields": {"notify.command": "none -> /bin/page, --key, hunter2"}}
    masked = Masker().document(row)
    assert masked == {"what": "roster", "fields": {"notify.command": MASK}}


def test_the_masked_roster_is_yaml_again() -> None:
    masked = mask_roster(f"a: 1\npassword: |\n  {SECRET}\nb: [2]\n")
    assert masked is not None
    assert yaml.safe_load(masked.text) == {"a": 1, "password": MASK, "b": [2]}
    assert parsed(GOOD) is not None
