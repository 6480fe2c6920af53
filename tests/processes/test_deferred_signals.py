"""Signals that wait for the end of a block, or for a step between."""

import signal
import sys
import threading

import pytest

from processes import deferred_signals

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(autouse=True)
def handlers():
    """Handlers as commands have them: they raise."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        signal.signal(number, lambda code, _: sys.exit(128 + code))
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def signalled(number, done, error=None):
    with deferred_signals():
        signal.raise_signal(number)
        done.append("the rest of the block")
        if error is not None:
            raise error


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_is_handled_at_the_end_of_the_block_and_the_next_one_at_once(number):
    done = []
    for _ in range(2):
        with pytest.raises(SystemExit, match=str(128 + number)):
            signalled(number, done)
        with pytest.raises(SystemExit, match=str(128 + number)):
            signal.raise_signal(number)
    assert len(done) == 2


def test_a_signal_is_handled_between_two_steps_and_not_once_more_at_the_end():
    with deferred_signals() as handle_signals:
        handle_signals()
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(SystemExit):
            handle_signals()


def test_blocks_within_each_other_wait_for_the_outermost():
    done = []
    with pytest.raises(SystemExit), deferred_signals():
        signalled(signal.SIGTERM, done)
    assert done


def test_a_signal_ends_a_block_that_an_error_has_ended():
    with pytest.raises(SystemExit):
        signalled(signal.SIGTERM, [], OSError())


def test_ignored_signals_stay_ignored():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with deferred_signals():
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        signal.raise_signal(signal.SIGHUP)


def test_another_thread_than_the_main_one_gets_no_signals_and_changes_no_handler():
    done = []

    def work():
        with deferred_signals() as handle_signals:
            handle_signals()
            done.append("the block")

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done
