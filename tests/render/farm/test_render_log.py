"""The log of a run is a plain file of its folder, or there is none."""

import logging
import os

import pytest

from render.farm.run_log import log_file


@pytest.mark.parametrize("kind", ["link", "pipe", "folder"])
def test_something_else_in_the_place_of_the_log_is_left_alone_and_not_waited_for(tmp_path, kind):
    place, other = tmp_path / "night-render.log", tmp_path / "dataset.json"
    other.write_text("{}")
    if kind == "link":
        place.symlink_to("dataset.json")
    elif kind == "pipe":
        os.mkfifo(place)
    else:
        place.mkdir()
    with log_file(place):
        logging.getLogger("render").info("hallo")
    assert other.read_text() == "{}"
    assert sorted(tmp_path.iterdir()) == [other, place]


def test_the_log_of_a_run_is_added_to_that_of_earlier_runs(tmp_path):
    place = tmp_path / "night-render.log"
    for word in ("first", "second"):
        with log_file(place):
            logging.getLogger("render").info(word)
    assert [line.split()[-1] for line in place.read_text().splitlines()] == ["first", "second"]
