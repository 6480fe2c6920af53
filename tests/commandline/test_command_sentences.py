"""The sentence that a command ends with: short, and harmless for a terminal, whatever a file holds."""

from commandline.sentences import sentence_of
from disk import NightError


def test_text_of_a_file_reaches_the_terminal_without_control_characters():
    sentence = sentence_of(NightError("unknown key a\x1b[31m\0\u202eb"), "render", "data")
    assert sentence == "unknown key a\\x1b[31m\\x00\\u202eb"


def test_long_text_of_a_file_is_shortened_and_the_reason_after_it_is_kept():
    for name in ("x" * 70_000, "x " * 35_000):
        sentence = sentence_of(NightError(f"preset {name}: File name too long"), "scenes", "data")
        assert sentence.startswith("preset x")
        assert sentence.endswith("File name too long")
        assert len(sentence) < 2010


def test_a_long_path_is_not_shortened():
    place = "/".join(["folder"] * 100)
    assert place in sentence_of(NightError(f"{place} is missing"), "scenes", "data")
