"""Every error's message is one printable line of bounded length, whatever a file or a flag put into it."""

import pickle

import pytest

from vntoolkit.errors import LONGEST_MESSAGE, BadCapture, VntError


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a\nb\tc", r"a\nb\tc"),
        ("erase \x1b[2J", r"erase \x1b[2J"),
        ("line\u2028break", r"line\u2028break"),
        ("name \udcff.png", r"name \udcff.png"),
        ("größe, 5 °", "größe, 5 °"),
    ],
)
def test_what_cannot_be_printed_becomes_its_escape(text, line):
    assert str(VntError(text)) == line


def test_a_long_message_keeps_both_ends():
    message = str(BadCapture("start " + "x" * 100_000 + " end"))
    assert len(message) <= LONGEST_MESSAGE
    assert message.startswith("start x")
    assert message.endswith("x end")


def test_an_error_survives_the_way_from_another_process():
    again = pickle.loads(pickle.dumps(BadCapture("a\nb")))
    assert type(again) is BadCapture
    assert str(again) == r"a\nb"
