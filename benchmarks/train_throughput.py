"""Training speed in samples per second, compared with a plain loop and with the limits of the machine.

One run on this machine measures three things:

- our training step in several precisions; rows are on the device, channels and augmentation are computed
  there;
- a plain loop with the same network, loss and Adam; channels and augmentation are computed in numpy for
  each batch;
- the roofline: the time of the multiplications and of the memory traffic of the network, at the speed of
  large matrix products and copies on this machine.

Run:

    .venv/bin/python benchmarks/train_throughput.py --size 80x60 --size 320x240
"""

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from itof import phase_per_metre
from itof.wall.wall_view import WallView
from model.data.augmentation import Draws
from model.data.batches import BatchMaker
from model.data.rows import RowBlock
from model.device import choose_device
from model.network.channels import InputSpec
from model.paper.loss import NightLoss
from model.run_folder.run_config import RunConfig
from model.settings.keys import merged, tables
from model.settings.presets import training_preset
from model.settings.train_settings import settings_from_dict
from model.training.processes import Processes
from model.training.step import TrainingStep

FREQUENCIES_HZ = (20e6, 50e6, 60e6)
VIEW = WallView(60.0, ((1, 0, 0), (0, 1, 0), (0, 0, 1)), (0, 0, 0), (0, 0, 2), (0, 0, -1))
# Caligiuri et al. 2024, sec. 4.2: 695 epochs of 2833 samples in about 4 h 40 min, RTX 2080 Ti. This is 24.2 s
# an epoch; 24 s give 118 samples/s.
PAPER_SAMPLES_PER_SECOND = 118
WAYS = ("plain", "float32", "bfloat16")


def main() -> None:
    """Measure every size and way in a separate process, because peak memory is that of the process."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", action="append", help="image size, default 80x60 and 320x240")
    parser.add_argument("--width", type=int, default=32)
    parser.add_argument("--batch-size", type=int, default=16)
    parser.add_argument(
        "--seconds", type=float, default=20.0, help="least time that each way is measured, default 20"
    )
    parser.add_argument("--device", default="auto", choices=["auto", "cpu", "cuda"])
    parser.add_argument("--way", choices=[*WAYS, "roofline"], help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.way:
        print(measured(given) if given.way != "roofline" else roofline(given))
        return
    print(f"{torch.get_num_threads()} threads, device {choose_device(given.device)}, width {given.width}")
    print(
        "| size | way | samples/s | times plain | of the roofline | peak memory |\n|---|---|---|---|---|---|"
    )
    for size in given.size or ["80x60", "320x240"]:
        limits = dict(zip(("float32", "bfloat16"), map(float, child(given, size, "roofline")), strict=True))
        plain = 0.0
        for way in WAYS:
            samples, memory = map(float, child(given, size, way))
            plain = plain or samples
            limit = limits["bfloat16" if "bfloat16" in way else "float32"]
            print(
                f"| {size} | {way} | {samples:.1f} | {samples / plain:.2f} | "
                f"{samples / limit:.0%} of {limit:.0f} | {memory / 1e6:.0f} MB |",
                flush=True,
            )
    print(f"the paper's machine: {PAPER_SAMPLES_PER_SECOND} samples/s at 320x240")


def child(given: argparse.Namespace, size: str, way: str) -> list[str]:
    """Numbers that a separate process prints for one size and way."""
    words = [__file__, "--size", size, "--way", way, "--width", given.width, "--device", given.device]
    words += ["--batch-size", given.batch_size, "--seconds", given.seconds]
    done = subprocess.run([sys.executable, *map(str, words)], check=True, stdout=subprocess.PIPE, text=True)
    return done.stdout.split()


def measured(given: argparse.Namespace) -> str:
    """Samples per second and peak memory in bytes of one way."""
    width, height = map(int, given.size[0].split("x"))
    device = choose_device(given.device)
    changes = {
        "network.width": given.width,
        "optimiser.batch_size": given.batch_size,
        "optimiser.learning_rate": 1e-6,
        "run.precision": "bfloat16" if "bfloat16" in given.way else "float32",
        "run.device": given.device,
    }
    settings = settings_from_dict(merged(training_preset("known-wall")[0], tables(changes)), "options")
    inputs = InputSpec("paper+residual", FREQUENCIES_HZ, 1.0, (1e-3,) * 5, "measured")
    config = RunConfig(settings, inputs, FREQUENCIES_HZ[0], VIEW, width, height, "", "", "", "0" * 64)
    block = random_block(width, height, 4 * given.batch_size)
    step = plain_step if given.way == "plain" else our_step
    samples = rate(step(config, block, device), given.batch_size, given.seconds, device)
    if device.type == "cuda":
        memory = torch.cuda.max_memory_allocated(device)
    else:
        memory = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # kilobytes
    return f"{samples} {memory}"


def random_block(width: int, height: int, count: int) -> RowBlock:
    """Rows with the direct return of a wall, hidden light and some object pixels."""
    rng = np.random.default_rng(0)
    direct = VIEW.direct_phasors(width, height, FREQUENCIES_HZ)
    opl_m = rng.uniform(6, 9, (count, height, width, 1))
    phasor = direct + 2e-3 * np.abs(direct) * np.exp(1j * opl_m * phase_per_metre(FREQUENCIES_HZ))
    mask = (rng.random((count, height, width)) < 1 / 31).astype(np.uint8)
    return RowBlock(
        tuple(range(count)),
        phasor.astype(np.complex64),
        (mask * (0.6 + 0.8j)).astype(np.complex64),
        (2.5 * mask).astype(np.float32),
        mask,
    )


def our_step(config: RunConfig, block: RowBlock, device: torch.device) -> Callable[[], None]:
    """A step of the real training, with rows on the device."""
    size = (config.image_width, config.image_height)
    reference = config.geometry.direct_phasors(*size, FREQUENCIES_HZ)
    wall = config.geometry.expected_wall(reference, FREQUENCIES_HZ)
    maker = BatchMaker.for_shards(config.inputs, FREQUENCIES_HZ, wall, device)
    rows, step = maker.upload(block), TrainingStep(config, maker, Processes(device), steps_per_epoch=100)
    generator = torch.Generator().manual_seed(0)

    def run() -> None:
        chosen = torch.randperm(len(rows), generator=generator)[: config.settings.optimiser.batch_size]
        draws = Draws.of(len(chosen), generator)
        step.take(step.loss_of(rows.take(chosen.tolist()), draws))

    return run


def plain_step(config: RunConfig, block: RowBlock, device: torch.device) -> Callable[[], None]:
    """A simple training step: channels in numpy, float32, images in the default memory format of PyTorch."""
    network = config.network().to(device)
    adam = torch.optim.Adam(network.parameters(), lr=1e-6)
    loss_of = NightLoss(config.readout)
    reference = config.geometry.direct_phasors(config.image_width, config.image_height, FREQUENCIES_HZ)
    rng = np.random.default_rng(0)

    def run() -> None:
        part = block.take(rng.permutation(len(block))[: config.settings.optimiser.batch_size].tolist())
        z = part.phasors
        noise = rng.standard_normal((*z.shape, 2)) @ np.array([1, 1j])
        channels = config.inputs.apply(z + 1e-4 * np.abs(z[..., :1]) * noise, reference)
        target = np.stack([part.target.real, part.target.imag], axis=1)
        arrays = [channels, target, part.radial_depth_m, part.mask.astype(np.float32)]
        for index in np.flatnonzero(rng.random(len(part)) < 0.5):
            for array in arrays:
                array[index] = np.flip(array[index], axis=-2).copy()
        tensors = [torch.from_numpy(array).to(device) for array in arrays]
        loss = loss_of(network(tensors[0]), *tensors[1:])
        adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        adam.step()
        loss.item()

    return run


def rate(step: Callable[[], None], batch_size: int, seconds: float, device: torch.device) -> float:
    """Samples per second, after three steps that warm up."""
    for _ in range(3):
        step()
    synchronise(device)
    started, steps = time.perf_counter(), 0
    while time.perf_counter() - started < seconds or steps < 3:
        step()
        steps += 1
        if device.type == "cuda" and steps % 20 == 0:
            synchronise(device)
    synchronise(device)
    return steps * batch_size / (time.perf_counter() - started)


def roofline(given: argparse.Namespace) -> str:
    """Samples per second at the limits of this machine, with float32 and with bfloat16 convolutions."""
    width, height = map(int, given.size[0].split("x"))
    device = choose_device(given.device)
    inputs = InputSpec("paper+residual", FREQUENCIES_HZ, 1.0, (1e-3,) * 5, "measured")
    changes = tables({"network.width": given.width})
    settings = settings_from_dict(merged(training_preset("known-wall")[0], changes), "options")
    config = RunConfig(settings, inputs, FREQUENCIES_HZ[0], VIEW, width, height, "", "", "", "0" * 64)
    network = config.network().to(device)
    written = 0

    def count(_: nn.Module, __: object, output: torch.Tensor) -> None:
        nonlocal written
        written += output.numel()

    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
            module.register_forward_hook(count)
    with FlopCounterMode(display=False) as counter:
        network(torch.rand(1, 12, height, width, device=device)).sum().backward()
    flops, limits = counter.get_total_flops(), []
    for number in (torch.float32, torch.bfloat16):
        # The output of each convolution is written once and read once, and so is its gradient.
        traffic = 4 * written * number.itemsize
        seconds = max(flops / flops_per_second(device, number), traffic / bytes_per_second(device))
        limits.append(1 / seconds)
    return " ".join(map(str, limits))


def flops_per_second(device: torch.device, number: torch.dtype) -> float:
    """Multiplications and additions per second in large matrix products."""
    size = 8192 if device.type == "cuda" else 2048
    a = torch.rand(size, size, device=device).to(number)
    return 2 * size**3 / fastest(lambda: a @ a, device)


def bytes_per_second(device: torch.device) -> float:
    """Bytes per second of copies, bytes read plus bytes written."""
    a = torch.rand(2**26, device=device)  # 256 MB, more than the caches
    b = torch.empty_like(a)
    return 2 * a.nbytes / fastest(lambda: b.copy_(a), device)


def fastest(work: Callable[[], object], device: torch.device) -> float:
    """Seconds of the fastest of eight runs."""
    times = []
    for _ in range(8):
        synchronise(device)
        started = time.perf_counter()
        work()
        synchronise(device)
        times.append(time.perf_counter() - started)
    return min(times)


def synchronise(device: torch.device) -> None:
    """Wait until the device has finished its work."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


if __name__ == "__main__":
    main()
