"""What `--help` says: the verb's whole docstring, no default that says nothing."""

import shlex

import pytest

from vntoolkit.__main__ import main
from vntoolkit.cli import EXAMPLES, VERBS, build_app


def help_of(verb: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", "400")  # no line of it is broken
    assert main([*verb.split(), "--help"]) == 0
    return capsys.readouterr().out


def test_the_list_gives_each_verb_a_line(capsys, monkeypatch):
    text = help_of("", capsys, monkeypatch)
    assert "Show normals and the surface of a camera live." in text
    assert "Frames that come too fast" not in text


@pytest.mark.parametrize(
    ("verb", "told"),
    [
        ("live", "Frames that come too fast are dropped and counted."),
        ("live", "a video plays at its own with --realtime"),
        (
            "simulate",
            "board_sweep, sphere, gel, jacket, sweater, sweater_stripes, sweater_logo",
        ),
        ("calibrate head", "variation of albedo passes for ambient light"),
        ("export", "The same command again continues an interrupted run"),
        ("evaluate tracks", "A vertex counts in a frame if its true point is visible there"),
    ],
)
def test_a_verb_tells_its_whole_story(verb, told, capsys, monkeypatch):
    text = help_of(verb, capsys, monkeypatch)
    assert told in text
    assert "default: None" not in text
    assert "default: False" not in text
    assert 'default: ""' not in text


def test_defaults_that_mean_something_are_shown(capsys, monkeypatch):
    text = help_of("export", capsys, monkeypatch)
    assert "[default: opengl]" in text
    assert "[choices: y, z] [default: y]" in text
    assert "[default: all]" in text  # frames


def test_no_flag_empties_a_list(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    text = help_of("dress", capsys, monkeypatch)
    assert "--exclude" in text
    assert "--empty-" not in text


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_an_example_that_it_takes(verb: str) -> None:
    _, *words = shlex.split(EXAMPLES[verb])
    assert words[: len(verb.split())] == verb.split()
    build_app(words).parse_args(words, exit_on_error=False, print_error=False)


def test_help_ends_with_the_example(capsys, monkeypatch):
    assert help_of("track", capsys, monkeypatch).rstrip().endswith("Example: vntoolkit track result")
    assert "Example: " in help_of("calibrate board", capsys, monkeypatch).splitlines()[-1]
