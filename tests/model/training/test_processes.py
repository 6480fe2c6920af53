"""Training in several processes, and processes that get a signal to stop."""

import signal
import subprocess
import time

import pytest
import torch
from synthetic_dataset import write_synthetic_dataset
from training_processes import COURSE, TORCHRUN, errors_of, start, wait_for_the_first_epoch
from training_runs import assert_same_end, checkpoint, settings

from model.training.loop import train
from model.training.processes import Processes

pytestmark = pytest.mark.usefixtures("one_thread")
CPU = torch.device("cpu")
ENDLESS = 10_000  # epochs, of which a test waits for the first


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_synthetic_dataset(tmp_path_factory.mktemp("dataset"), count=16)


@pytest.fixture
def start_two():
    """Start two processes of one training, as a launcher on one machine does."""
    stores = []

    def start_both(dataset, out, *options, **changes) -> list[subprocess.Popen]:
        # The launcher's store, by which the processes find each other, outlives them.
        stores.append(torch.distributed.TCPStore("127.0.0.1", 0, is_master=True, wait_for_workers=False))
        common = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(stores[-1].port), "WORLD_SIZE": "2"}
        common |= {"LOCAL_WORLD_SIZE": "2"}
        common |= {"TORCHELASTIC_USE_AGENT_STORE": "True", "TORCHELASTIC_RESTART_COUNT": "0"}
        places = [common | {"RANK": str(rank), "LOCAL_RANK": str(rank)} for rank in (0, 1)]
        return [start(dataset, out, *options, environment=place, **changes) for place in places]

    return start_both


def epochs_before_the_stop(run) -> int:
    done = len(checkpoint(run)["history"])
    assert 0 < done < ENDLESS, errors_of(run).read_text()
    return done


@pytest.mark.parametrize("count", [1, 2, 3, 4])
@pytest.mark.parametrize("batch", [1, 2, 3, 7, 8])
def test_shares_of_a_batch_are_all_of_it_once_and_the_lent_row_counts_nothing(count, batch):
    rows = list(range(10, 10 + batch))
    processes = [Processes(CPU, rank, count) for rank in range(count)]
    own = [p.share(rows)[: p.own(batch)] for p in processes]
    assert sorted(row for share in own for row in share) == rows
    assert all(p.share(rows) for p in processes)


# Nine scenes: batches of 4, 4, 1 and of 5, 4. In a batch of one scene, one of the processes has none.
@pytest.mark.long
@pytest.mark.parametrize(
    "special",
    [
        {"batch_size": 5},
        pytest.param({"batch_size": 4}, marks=pytest.mark.thorough),
        pytest.param({"copies_per_change": 3}, marks=pytest.mark.thorough),
        {"bounce_images": True},
        pytest.param({"optimiser": "muon"}, marks=pytest.mark.thorough),
    ],
    ids=lambda special: next(f"{name}={value}" for name, value in special.items()),
)
def test_two_processes_train_the_network_of_one(dataset, tmp_path, special):
    changes = {"batch_size": 4, "max_epochs": 2, "noise_sigma": 1e-3, "clip_norm": 1.0} | special
    changes["checkpoint_minutes"] = 0.0  # a checkpoint after every batch must not count anything twice
    two = tmp_path / "two"
    assert start(dataset, two, launcher=TORCHRUN, **changes).wait() == 0, errors_of(two).read_text()
    train(dataset, tmp_path / "one", settings(**COURSE | changes))
    begin = settings(**COURSE | changes | {"learning_rate": 1e-30, "max_epochs": 1})
    train(dataset, tmp_path / "begin", begin)  # its steps are too small to change the initial weights
    first, one, two = (checkpoint(tmp_path / name) for name in ("begin", "one", "two"))
    for name, weight in one["network"].items():
        if name.startswith("images."):  # of the corner, not trained: one process makes them for all
            assert torch.equal(two["network"][name], weight), name
            continue
        # Sums in another order: rounding, which Adam's division by small gradients makes larger.
        allowed = 1e-2 * float((weight - first["network"][name]).norm())
        assert float((two["network"][name] - weight).norm()) <= allowed, name
    for a, b in zip(one["history"], two["history"], strict=True):
        assert b == pytest.approx(a, rel=1e-3)  # rounding, as above: chosen, a tenth of it


@pytest.mark.long
def test_two_processes_stop_together_when_one_is_asked_to_and_go_on(dataset, start_two, tmp_path):
    run, changes = tmp_path / "run", {"max_epochs": ENDLESS, "batch_size": 2}
    processes = start_two(dataset, run, **changes)
    wait_for_the_first_epoch(run, *processes)
    processes[1].send_signal(signal.SIGTERM)
    codes = [process.wait() for process in processes]
    assert codes == [128 + signal.SIGINT, 128 + signal.SIGTERM], errors_of(run).read_text()
    changes["max_epochs"] = epochs_before_the_stop(run) + 1
    processes = start_two(dataset, run, "--resume", **changes)
    assert [process.wait() for process in processes] == [0, 0], errors_of(run).read_text()
    assert len(checkpoint(run)["history"]) == changes["max_epochs"]


@pytest.mark.thorough
def test_two_processes_whose_launcher_is_stopped_go_on_to_the_same_weights(dataset, tmp_path):
    run, changes = tmp_path / "run", {"max_epochs": ENDLESS, "batch_size": 2}
    process = start(dataset, run, launcher=TORCHRUN, **changes)
    wait_for_the_first_epoch(run, process)
    process.send_signal(signal.SIGTERM)
    process.wait()
    changes["max_epochs"] = epochs_before_the_stop(run) + 1
    for out, options in ((run, ["--resume"]), (tmp_path / "whole", [])):
        process = start(dataset, out, *options, launcher=TORCHRUN, **changes)
        assert process.wait() == 0, errors_of(out).read_text()
    assert_same_end(run, tmp_path / "whole")


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.thorough)])
def test_a_process_ends_as_its_signal_says_and_the_run_goes_on_to_the_same_weights(dataset, tmp_path, number):
    run, changes = tmp_path / "run", {"max_epochs": ENDLESS, "batch_size": 1, "ema_decay": 0.9}
    process = start(dataset, run, **changes)
    wait_for_the_first_epoch(run, process)
    time.sleep(0.05)  # into the next epoch
    process.send_signal(number)
    assert process.wait() == 128 + number, errors_of(run).read_text()
    longer = settings(**COURSE | changes | {"max_epochs": epochs_before_the_stop(run) + 1})
    assert train(dataset, run, longer, resume=True) == train(dataset, tmp_path / "whole", longer)
    assert_same_end(run, tmp_path / "whole")
