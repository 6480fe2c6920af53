"""The dataset card: a README.md with the contents of a dataset, how it was made, and how to read it.

It begins with the YAML header that data hubs read. `render.products.croissant` writes the same as data.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from disk import NightError
from disk.byte_size import size
from disk.counted import counted
from disk.frequency_text import megahertz
from disk.plain_file import read_plain
from itof import DEPTH_CHANNEL, MASK_CHANNEL, combined_range_m
from render.products.distributions import SPLITS, Distributions, balance_sentence, size_text
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, TRANSIENT_FILE, Dataset, Preset

CARD_FILE = "README.md"
CONTACT_SHEET, DISTRIBUTIONS = "preview/contact_sheet.png", "preview/distributions.png"
_HUB_LICENCES = frozenset(
    {"apache-2.0", "cc-by-4.0", "cc-by-nc-4.0", "cc-by-nc-sa-4.0", "cc-by-sa-4.0", "cc0-1.0", "mit", "odc-by"}
)  # by the names that hubs give them
_SIZES = ((1000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_MARK = re.compile(r"<!-- night-gen preview writes this file; licence: (?P<licence>.*) -->")


class CardError(NightError):
    """A licence cannot be written into a card, or a picture of the card would replace one of the user."""


@dataclass(frozen=True)
class EarlierCard:
    """The README.md of a dataset before the card is written.

    Attributes
    ----------
    is_ours : whether this program wrote it, so that it may be replaced; True if there is no file.
    licence : the licence in it, None without one.
    """

    is_ours: bool
    licence: str | None


def read_card(dataset: Dataset) -> EarlierCard:
    """Read the README.md of a dataset."""
    file = dataset.root / CARD_FILE
    if not file.exists():
        return EarlierCard(is_ours=True, licence=None)
    try:
        mark = _MARK.search(read_plain(file).decode(errors="replace"))
    except OSError:
        mark = None
    try:
        licence = json.loads(mark["licence"]) if mark else None
    except (ValueError, RecursionError):
        licence = None
    is_text = isinstance(licence, str) and licence.isprintable()
    return EarlierCard(is_ours=mark is not None, licence=licence if is_text else None)


def checked_licence(licence: str) -> str:
    """A licence on one line; `CardError` if it is empty or not printable."""
    words = " ".join(licence.split())
    if not words.isprintable() or not words:
        raise CardError('--licence needs the name of a licence, like "CC BY 4.0"')
    return words


def dataset_card(dataset: Dataset, found: Distributions, licence: str | None) -> str:
    """Text of the card, in Markdown. It has no information about the machine that makes it."""
    name = dataset.root.resolve().name
    parts = [
        _header(name, len(dataset.ids()), licence),
        f"# {name}",
        f"<!-- night-gen preview writes this file; licence: {_escaped(licence)} -->",
        about(dataset, found),
        f"![Scenes from outside, as measured, and in ground truth]({CONTACT_SHEET})",
        f"## Scenes\n\n{_class_table(found)}",
        f"![What the scenes are drawn from]({DISTRIBUTIONS})",
        f"## Figures\n\n{_table(('', ''), _facts(dataset, found))}",
        f"## How it was made\n\n{_making(dataset)}",
        f"## How to read it\n\n{_reading(dataset, found)}",
        f"## Licence\n\n{_licence_text(licence)}",
        f"## Citation\n\nThe scenes follow\n\n> {CITATION}",
    ]
    return "\n\n".join(parts) + "\n"


def _escaped(text: str | None) -> str:
    """A text as JSON in an HTML comment, which ends at the first "--": escapes replace these characters."""
    return json.dumps(text).replace("--", "\\u002d\\u002d").replace(">", "\\u003e")


def _header(name: str, count: int, licence: str | None) -> str:
    """The YAML header; a text in the quotes of JSON is YAML, too."""
    lines = [f"pretty_name: {_escaped(name)}"]
    known = (licence or "").lower().replace(" ", "-")
    if known in _HUB_LICENCES:
        lines.append(f"license: {known}")
    elif licence is not None:
        lines += ["license: other", f"license_name: {_escaped(licence)}"]
    lines += [
        "task_categories: [depth-estimation]",
        "tags: [non-line-of-sight, indirect-time-of-flight, openexr]",
        f"size_categories: [{next((words for most, words in _SIZES if count < most), 'n>1M')}]",
    ]
    return "\n".join(["---", *lines, "---"])


def about(dataset: Dataset, found: Distributions) -> str:
    """What the dataset is, in three sentences."""
    rendered = len(found.object_pixels)
    if dataset.is_measured:
        return (
            f"{len(dataset.ids())} look-behind-a-corner scenes, captured with an indirect time-of-flight "
            "camera that looks at a wall. A small part of the light that returns to it has met an object "
            "hidden behind a corner. Each scene has the measurement of the camera and, as ground truth, the "
            "radial depth of the object's mirror image, from a capture of a mirror on the wall. Made with "
            "NIGHT."
        )
    return (
        f"{len(dataset.ids())} synthetic look-behind-a-corner scenes, {rendered} of them rendered. An "
        "indirect time-of-flight camera looks at a wall. A small part of the light that returns to it has "
        "met an object hidden behind a corner. Each rendered scene has the measurement of the camera and, "
        "as ground truth, the radial depth of the object's mirror image in the wall. Made with NIGHT."
    )


def _class_table(found: Distributions) -> str:
    rows = [
        (name, *(str(counts[split]) for split in SPLITS), str(sum(counts.values())))
        for name, counts in found.class_counts.items()
    ]
    sums = [sum(counts[split] for counts in found.class_counts.values()) for split in SPLITS]
    rows.append(("all", *map(str, sums), str(sum(sums))))
    return _table(("class", *SPLITS, "all"), rows)


def _facts(dataset: Dataset, found: Distributions) -> list[tuple[str, str]]:
    preset, rendering = dataset.preset, dataset.rendering
    camera, axis = preset.camera, preset.transient
    asked = f"{camera.width} x {camera.height} pixels asked for"
    made = "measured" if dataset.is_measured else "rendered"
    rendered = f"{size_text(found.image_sizes)} {made}" if found.image_sizes else f"none {made}"
    bins = (
        f"{axis.bin_count} bins of {axis.bin_width_m:g} m optical path length (out and back), from "
        f"{axis.start_opl_m:g} m"
    )
    error = "not recorded"
    if rendering is not None and rendering.hidden_error_median is not None:
        error = f"median {rendering.hidden_error_median:.2%}"
        if rendering.hidden_error_max is not None:
            error += f", at most {rendering.hidden_error_max:.2%}"
    hertz = megahertz(*preset.itof.frequencies_hz, between=" MHz, ")
    unambiguous_m = combined_range_m(preset.itof.frequencies_hz)
    of_light = [
        ("time axis", bins),
        ("light paths", f"at most {axis.max_bounces} surfaces"),
        ("error of the hidden signal, upper bound", error),
    ]
    return [
        ("images", f"{asked}, {rendered}; horizontal field of view {_fov_text(preset)}"),
        ("frequencies", f"{hertz}; unambiguous over {unambiguous_m:.2f} m of depth"),
        ("pixels", balance_sentence(found)),
        *([] if dataset.is_measured else of_light),
        ("disk used", ", ".join(f"{name} {size(count)}" for name, count in _disk(dataset.root))),
    ]


def _fov_text(preset: Preset) -> str:
    fov_deg, spread_deg = preset.camera.horizontal_fov_deg, preset.camera_spread.horizontal_fov_deg
    if not spread_deg:
        return f"{fov_deg:g} degrees"
    ends = f"{fov_deg - spread_deg:g} to {fov_deg + spread_deg:g} degrees"
    return f"{ends}, that of each scene in its `scene.json`"


def _making(dataset: Dataset) -> str:
    index, rendering = dataset.index, dataset.rendering
    if dataset.is_measured:
        made = [("scenes by", f"{index.generator} {index.generator_version}")]
        made.append(("in `scene.json`", "a sphere about what the mirror showed; its material is not known"))
    else:
        blender = f"Blender {index.blender_version}"
        made = [("scenes by", f"{index.generator} {index.generator_version}, {blender}")]
        made.append(("seed", f"{index.seed}; scene *i* depends on the seed and *i* alone"))
    if index.packages:
        made.append(("packages of the scenes", _versions(index.packages)))
    made += [(f"mesh `{shape}`", f"SHA-256 {digest}") for shape, digest in index.meshes.items()]
    if rendering is None:
        made.append(("rendering", "none: measured" if dataset.is_measured else "not recorded"))
    else:
        options = ", ".join(
            f"{name} {value}" for name, value in rendering.options.items() if value is not None
        )
        made += [
            ("rendering", f"method {rendering.method} ({options}), product {rendering.product}"),
            (
                "rendered images",
                f"{rendering.width} x {rendering.height} pixels, {counted(rendering.scene_count, 'scene')}",
            ),
            ("light paths rendered", f"at most {rendering.max_bounces} surfaces"),
            ("packages of the renders", _versions(rendering.packages)),
        ]
    changes = dict(_differences(index.preset))
    if set(changes) <= {"dataset.count", "dataset.seed"} and not dataset.is_measured:
        count = index.preset.dataset.count
        made.append(
            ("to make the scenes again", f"`night-gen scenes OUT --count {count} --seed {index.seed}`")
        )
    else:
        made += [(f"preset key `{key}`", f"`{value}`") for key, value in changes.items()]
    return (
        f"{_table(('', ''), made)}\n\nPreset keys that are not listed here have the value of the preset "
        "`paper`: that of the paper's text where it gives one, else of the authors' released code, else "
        "NIGHT's own. `dataset.json` has all keys."
    )


def _reading(dataset: Dataset, found: Distributions) -> str:
    scene_id = next(iter(found.object_pixels), dataset.ids()[0])
    drawn = "" if dataset.is_measured else ", and as Mitsuba 3 files with their meshes"
    files = f"the scene as data{drawn}"
    rendered = (
        ""
        if dataset.is_measured
        else f"\n- `renders/{scene_id}/{TRANSIENT_FILE}`: the transient, if it was rendered\n"
        "- `renders/rendering.json`: how the scenes were rendered"
    )
    return f"""Each scene has its own folder. All images are OpenEXR files with 32-bit floats.

- `dataset.json`: the scene list (id, class, split) and the preset
- `scenes/{scene_id}/`: {files}
- `renders/{scene_id}/{MEASUREMENT_FILE}`: complex phasors `itof.<f>MHz.Re`, `.Im`
- `renders/{scene_id}/{GROUND_TRUTH_FILE}`: `{DEPTH_CHANNEL}` (radial depth in metres, 0 on background),
  `{MASK_CHANNEL}`{rendered}

```python
from itof import DepthMap, phase, read_image, unwrap_depth

z, frequencies_hz = read_image("renders/{scene_id}/{MEASUREMENT_FILE}").phasors()  # (H, W, F) complex
wall_depth_m = unwrap_depth(phase(z), frequencies_hz)
hidden_depth_m = DepthMap.read("renders/{scene_id}/{GROUND_TRUTH_FILE}").radial_depth_m  # (H, W)
```"""


def _licence_text(licence: str | None) -> str:
    if licence is not None:
        return licence
    return 'No licence has been chosen yet. Set one with `night-gen preview DATASET --licence "CC BY 4.0"`.'


CITATION = (
    "M. Caligiuri, A. Simonetto, P. Zanuttigh: *NIGHT - Non-Line-of-Sight Imaging from Indirect Time of "
    "Flight Data*. European Conference on Computer Vision Workshops (ECCV-W), 2024. arXiv 2403.19376."
)


def _differences(preset: Preset) -> Iterator[tuple[str, str]]:
    """Keys and values of a preset that differ from the defaults, which are those of ``paper``."""
    ours, papers = _flat(asdict(preset)), _flat(asdict(Preset()))
    yield from ((key, json.dumps(value)) for key, value in ours.items() if value != papers[key])


def _flat(data: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in data.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return flat


def _disk(root: Path) -> Iterator[tuple[str, int]]:
    """Name and size in bytes of the folders of a dataset."""
    for name in ("scenes", "renders", "shards"):
        if (root / name).is_dir():
            yield name, sum(file.stat().st_size for file in (root / name).rglob("*") if file.is_file())


def _versions(packages: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in packages.items())


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
