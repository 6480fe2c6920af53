"""What noise on the network's input channels leaves of the hidden light, by the noise's standard deviation.

For the components of the paper's channels (Re and Im of every frequency, divided by the amplitude at the
first one): the noise over the root mean square of the hidden light in a pixel, and the signal-to-noise ratio
of a whole image, which is what the best linear detector of a known hidden picture reaches. Run on a rendered
dataset:

    .venv/bin/python benchmarks/channel_noise.py noise40
"""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from itof import amplitude, read_image
from scenegen import Dataset, open_dataset

SIGMAS = (1.0, 0.03, 1e-4)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    given = parser.parse_args()
    dataset = open_dataset(given.dataset)
    hidden = np.stack([hidden_components(dataset, scene) for scene in dataset.ids()])  # (N, H, W, 2F)
    rms = float(np.sqrt(np.mean(hidden**2)))
    height, width = hidden.shape[1:3]
    print(f"{len(hidden)} scenes at {width} x {height}; hidden light {rms:.2g} of the channels' unit (rms)\n")
    print("| sigma | noise over hidden light, one pixel | signal to noise, image: least, median, most |")
    print("|---|---|---|")
    whole = np.sqrt(np.sum(hidden**2, axis=(1, 2, 3)))  # (N,)
    for sigma in SIGMAS:
        ratios = ", ".join(f"{value:.2g}" for value in np.quantile(whole / sigma, [0, 0.5, 1]))
        print(f"| {sigma:g} | {sigma / rms:.2g} | {ratios} |")


def hidden_components(dataset: Dataset, scene: str) -> NDArray[np.float64]:
    """(H, W, 2F) Re and Im of the hidden light of a scene in the paper's channels."""
    image = read_image(dataset.render_folder(scene) / "itof.exr")
    total, _ = image.phasors()
    hidden = image.phasors("hidden")[0] / amplitude(total[..., :1])
    return np.concatenate([hidden.real, hidden.imag], axis=-1)


if __name__ == "__main__":
    main()
