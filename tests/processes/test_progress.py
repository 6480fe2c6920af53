"""Progress without a terminal: lines that a log can hold. (The bar in a terminal is tqdm's own.)"""

import io
import os
import pty
import subprocess
import sys
import termios

from processes.progress import Lines, showing_progress


class Clock:
    """Time that passes when it is told to."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


def run_of(total, steps, *, initial=0, count=1, description="render", before_exit=lambda bar: None):
    """Lines of work that takes so many seconds before each update."""
    stream, clock = io.StringIO(), Clock()
    with Lines(total, "scene", description, initial=initial, stream=stream, clock=clock) as lines:
        for step_s in steps:
            clock.now_s += step_s
            lines.update(count)
        before_exit(lines)
    return stream.getvalue().splitlines()


def test_a_line_appears_at_every_twentieth_of_the_work():
    lines = run_of(400, [1.0] * 400)
    assert len(lines) == 20
    assert lines[0] == "render: 20 of 400 scenes, 1.0 scenes/s, 6 min left"
    assert lines[-1] == "render: 400 of 400 scenes, 1.0 scenes/s, 7 min in all"


def test_fast_work_prints_at_most_one_line_a_second():
    lines = run_of(1000, [0.01] * 1000)  # ten seconds: a twentieth takes half of one
    assert len(lines) == 10
    assert lines[-1].startswith("render: 1000 of 1000 scenes, 100.0 scenes/s")


def test_slow_work_prints_a_line_every_half_minute():
    lines = run_of(1000, [10.0] * 9)  # a twentieth takes eight minutes
    assert [line.split(" of")[0] for line in lines] == ["render: 3", "render: 6", "render: 9"]
    assert lines[0] == "render: 3 of 1000 scenes, 10.0 s/scene, 2.8 h left"


def test_work_of_less_than_a_second_prints_nothing():
    assert run_of(5, [0.19] * 5) == []


def test_the_last_line_says_where_interrupted_work_stopped():
    lines = run_of(1000, [31.0, 1.0, 1.0])
    assert [line.split(" of")[0] for line in lines] == ["render: 1", "render: 3"]


def test_the_wait_before_the_first_scene_makes_no_pace():
    lines = run_of(384, [100.0] + [1.0] * 383)
    assert lines[0] == "render: 1 of 384 scenes"
    assert lines[1] == "render: 21 of 384 scenes, 1.0 scenes/s, 6 min left"
    assert lines[-1] == "render: 384 of 384 scenes, 1.3 s/scene, 8 min in all"


def test_scenes_that_are_done_at_once_make_no_pace():
    batch = [10.0] + [1e-3] * 19
    lines = run_of(100, [100.0, *batch[1:], *batch * 4])
    assert lines[0] == "render: 1 of 100 scenes"
    assert lines[1] == "render: 21 of 100 scenes, 10.0 s/scene, 13 min left"  # one after the first 20
    assert lines[2] == "render: 41 of 100 scenes, 1.0 scenes/s, 56 s left"  # 21 in 20.02 s


def test_work_that_was_done_before_makes_no_pace():
    lines = run_of(100, [2.0] * 10, initial=50)
    assert lines[0] == "render: 55 of 100 scenes, 2.0 s/scene, 2 min left"


def test_work_of_unknown_size_has_no_end_in_sight():
    assert run_of(None, [31.0, 31.0], description="") == [
        "1 scene, 31 s so far",
        "2 scenes, 31.0 s/scene, 62 s so far",
    ]


def test_a_line_shows_the_latest_description_and_values():
    def name_it(lines):
        lines.set_description("epoch 7")
        lines.set_postfix(train="0.0120", refresh=False)
        lines.update(3)

    lines = run_of(10, [2.0, 2.0], before_exit=name_it)
    assert lines[-1] == "epoch 7: 5 of 10 scenes, 2.0 scenes/s, 2 s left (train=0.0120)"


def test_a_log_that_takes_no_more_lines_stops_no_work():
    clock = Clock()
    reader, writer = os.pipe()
    os.close(reader)
    broken = io.TextIOWrapper(io.FileIO(writer, "w"), write_through=True)
    with Lines(10, "scene", stream=broken, clock=clock) as lines:
        clock.now_s += 2
        lines.update()
        broken.close()
        clock.now_s += 2
        lines.update()


def test_nothing_is_printed_where_progress_is_not_wanted(capsys):
    with showing_progress(2, "scene", show=False) as bar:
        bar.update(2)
    assert capsys.readouterr() == ("", "")


def test_a_terminal_shows_a_bar():
    code = (
        "from processes.progress import showing_progress\n"
        "with showing_progress(3, 'scene', 'render') as bar: bar.update(3)"
    )
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 80))
    done = subprocess.run([sys.executable, "-c", code], stderr=theirs, check=True)
    os.close(theirs)
    shown = os.read(ours, 65536).decode()
    os.close(ours)
    assert done.returncode == 0
    assert "render: 100%" in shown
    assert "3/3" in shown
