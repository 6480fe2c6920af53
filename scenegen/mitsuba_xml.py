"""Mitsuba 3 scene files for plain Mitsuba. NIGHT writes them and never reads them.

A scene file can load any plugin and any file, so reading one means running whatever it names.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

from scenegen.mitsuba_description import Description, mirrored_description, seen_description
from scenegen.scene import Scene

SEEN_XML, MIRRORED_XML = "scene.xml", "mirrored.xml"
# Element of each plugin that a scene has.
_TAGS = {
    "path": "integrator",
    "perspective": "sensor",
    "hdrfilm": "film",
    "box": "rfilter",
    "independent": "sampler",
    "projector": "emitter",
    "bitmap": "texture",
    "twosided": "bsdf",
    "diffuse": "bsdf",
    "roughplastic": "bsdf",
    "ply": "shape",
}
_VALUE_TAGS = {bool: "boolean", int: "integer", float: "float", str: "string"}


def scene_files_for_mitsuba(scene: Scene) -> dict[str, str]:
    """Text of ``scene.xml`` and ``mirrored.xml``, by file name; paths in them are relative to the file."""
    return {
        SEEN_XML: scene_xml(seen_description(scene)),
        MIRRORED_XML: scene_xml(mirrored_description(scene)),
    }


def scene_xml(description: Description) -> str:
    """A description of `scenegen.mitsuba_description` as the text of a Mitsuba scene file."""
    root = ET.Element("scene", version="3.0.0")
    for name, part in description.items():
        if name != "type":
            _add(root, name, part, "id")
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _add(parent: ET.Element, name: str, value: Any, naming: str) -> None:
    """Add one entry of a description; `naming` is the attribute that holds the name of a plugin."""
    match value:
        case {"type": "ref", "id": target}:
            ET.SubElement(parent, "ref", {"id": target, "name": name})
        case {"type": "spectrum", "value": reflectance}:
            ET.SubElement(parent, "spectrum", {"name": name, "value": repr(reflectance)})
        case {"type": plugin, **parts}:
            tag = _TAGS[plugin]
            named = {} if name == tag else {naming: name}
            element = ET.SubElement(parent, tag, {"type": plugin, **named})
            for key, part in parts.items():
                _add(element, str(key), part, "name")
        case [*rows]:
            transform = ET.SubElement(parent, "transform", {"name": name})
            numbers = " ".join(f"{number:.9g}" for row in rows for number in row)
            ET.SubElement(transform, "matrix", {"value": numbers})
        case _:
            text = str(value).lower() if isinstance(value, bool) else str(value)
            ET.SubElement(parent, _VALUE_TAGS[type(value)], {"name": name, "value": text})
