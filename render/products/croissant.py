"""The dataset card as data: ``croissant.json``, JSON-LD in the vocabulary Croissant 1.0 of MLCommons.

Source: https://docs.mlcommons.org/croissant/docs/croissant-spec.html
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

from disk import sha256_of
from disk.plain_file import MOST_LIST_BYTES, read_plain
from render.products.card import CITATION, about
from render.products.distributions import Distributions
from scenegen import GROUND_TRUTH_FILE, MEASUREMENT_FILE, RENDERING_FILE, TRANSIENT_FILE, Dataset

CROISSANT_FILE = "croissant.json"
_WRITER = "night-gen preview"  # by which an earlier file of ours is recognised
_INDEX = "dataset.json"
_TERMS = (
    *("citeAs", "column", "extract", "field", "fileObject", "fileProperty", "fileSet", "format", "includes"),
    *("isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet", "references", "regex"),
    *("repeated", "replace", "separator", "source", "subField", "transform"),
)
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "sc": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{term: f"cr:{term}" for term in _TERMS},
}
_SCENE_FIELDS = {
    "id": "name of its folders",
    "object_class": "what is hidden",
    "split": "train, validation or test",
}


def has_no_other_croissant(dataset: Dataset) -> bool:
    """Whether there is no croissant.json, or one that this program wrote and may replace."""
    file = dataset.root / CROISSANT_FILE
    if not file.exists():
        return True
    try:
        return f'"name": "{_WRITER}"'.encode() in read_plain(file, MOST_LIST_BYTES)
    except OSError:
        return False


def croissant(dataset: Dataset, found: Distributions, licence: str | None) -> str:
    """Text of the file: the dataset as a whole, its files, and the list of its scenes."""
    made = datetime.fromtimestamp((dataset.root / _INDEX).stat().st_mtime, UTC)
    index = dataset.index
    data = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": dataset.root.resolve().name,
        "description": about(dataset, found),
        "license": licence or "no licence has been chosen yet",
        "url": "./",  # where this file is published
        "creator": {"@type": "Organization", "name": f"made by {index.generator} {index.generator_version}"},
        "datePublished": made.date().isoformat(),
        "citeAs": CITATION,
        "sdPublisher": {"@type": "Organization", "name": _WRITER},
        "distribution": _files(dataset),
        "recordSet": [_scenes()],
    }
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _files(dataset: Dataset) -> list[dict[str, Any]]:
    """The files that describe the whole dataset, with their hashes, and the sets of files of each scene."""
    named = [_INDEX, f"renders/{RENDERING_FILE}"]
    files = [
        {
            "@type": "cr:FileObject",
            "@id": name,
            "name": name,
            "contentUrl": name,
            "encodingFormat": "application/json",
            "sha256": sha256_of(dataset.root / name),
        }
        for name in named
        if (dataset.root / name).is_file()
    ]
    sets = {
        f"renders/*/{MEASUREMENT_FILE}": ("image/x-exr", "complex phasors, channels itof.<f>MHz.Re and .Im"),
        f"renders/*/{GROUND_TRUTH_FILE}": ("image/x-exr", "radial depth in metres and mask"),
        f"renders/*/{TRANSIENT_FILE}": ("image/x-exr", "light over optical path length"),
        "scenes/*/scene.json": ("application/json", "shapes, materials, positions and camera"),
    }
    return files + [
        {
            "@type": "cr:FileSet",
            "@id": pattern,
            "name": pattern,
            "description": words,
            "encodingFormat": kind,
            "includes": pattern,
        }
        for pattern, (kind, words) in sets.items()
        if next(dataset.root.glob(pattern), None) is not None
    ]


def _scenes() -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": "scenes",
        "name": "scenes",
        "key": {"@id": "scenes/id"},
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"scenes/{name}",
                "name": name,
                "description": words,
                "dataType": "sc:Text",
                "source": {"fileObject": {"@id": _INDEX}, "extract": {"jsonPath": f"$.scenes[*].{name}"}},
            }
            for name, words in _SCENE_FIELDS.items()
        ],
    }
