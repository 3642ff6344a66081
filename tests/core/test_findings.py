from __future__ import annotations

import copy
import json
import pickle
from collections.abc import Callable

import pytest

from torch_orennayar import Finding
from torch_orennayar.core.findings import CODES

FOUND = Finding("3 pixels are lit by fewer than 3 lights.", "dark-pixels", 3)


def test_a_finding_is_its_sentence() -> None:
    text = "3 pixels are lit by fewer than 3 lights."
    assert isinstance(FOUND, str)
    assert text == FOUND
    assert hash(text) == hash(FOUND)
    assert "fewer" in FOUND
    assert f"{FOUND} {'; '.join([FOUND])}" == f"{text} {text}"
    assert json.loads(json.dumps([FOUND])) == [text]


def test_code_and_value() -> None:
    assert (FOUND.code, FOUND.value) == ("dark-pixels", 3)
    assert Finding("No occluding contour.", "no-contour").value is None


@pytest.mark.parametrize("same", [copy.copy, copy.deepcopy, lambda found: pickle.loads(pickle.dumps(found))])
def test_copies_and_pickles_keep_code_and_value(same: Callable[[Finding], Finding]) -> None:
    copied = same(FOUND)
    assert type(copied) is Finding
    assert (copied, copied.code, copied.value) == (FOUND, "dark-pixels", 3)
    (inside,) = pickle.loads(pickle.dumps({"report": [FOUND]}))["report"]
    assert inside.code == "dark-pixels"


def test_unknown_codes_are_refused() -> None:
    with pytest.raises(KeyError, match="dark-pixel'"):
        Finding("3 pixels.", "dark-pixel")


def test_codes_are_words_joined_by_hyphens_and_explained() -> None:
    for code, meaning in CODES.items():
        assert all(word.isalpha() and word.islower() for word in code.split("-")), code
        assert meaning
        assert not meaning.endswith(".")
