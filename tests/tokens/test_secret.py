"""The form of a token."""

from __future__ import annotations

import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lecombus.tokens.secret import digest_of, is_well_formed, new_secret


def test_a_token_has_256_random_bits_and_a_form_that_scanners_find() -> None:
    made = {new_secret() for _ in range(200)}
    assert len(made) == 200
    for one in made:
        assert one.startswith("lcb_")
        assert len(one) == 4 + 43 + 6
        assert set(one[4:]) <= set(string.ascii_letters + string.digits)
        assert is_well_formed(one)
    # Each of the last 42 random characters takes every digit: none of them is fixed.
    assert all(len({one[at] for one in made}) > 40 for at in range(5, 47))


@given(st.integers(4, 52), st.sampled_from(string.ascii_letters + string.digits))
def test_one_wrong_character_is_seen(at: int, other: str) -> None:
    secret = new_secret()
    mistyped = secret[:at] + other + secret[at + 1 :]
    assert is_well_formed(mistyped) == (mistyped == secret)


@pytest.mark.parametrize("cut", [0, 1, 4, 40, 52])
def test_a_part_of_a_token_is_none(cut: int) -> None:
    assert not is_well_formed(new_secret()[:cut])


@given(st.text())
def test_other_texts_are_none(text: str) -> None:
    assert not is_well_formed(text)
    assert not is_well_formed(f"lcb_{text}")


def test_the_check_characters_of_a_known_token_stay_the_same() -> None:
    """Tokens that were given out stay valid in later versions."""
    known = f"lcb_{'0' * 42}74fGSrp"
    assert is_well_formed(known)
    assert digest_of(known) == "28e407c3ea1428dbf776ba4012d4fb64e2e80be994118a1f9399b34518297b67"
