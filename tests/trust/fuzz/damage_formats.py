"""Damage inside the structure of a format, so that what lies behind its first check is reached."""

import io
import json
import struct
import zipfile

import h5py
from damage import ANY_BYTES, ANY_TEXT, NUMBERS, OUTSIDE, TEXTS, choice, replace_a_token


def json_tree(rng, data, other):
    """A key or item of valid JSON removed, renamed, or replaced by a value of another type or size."""
    tree = json.loads(data)
    place, key = _any_place(rng, tree)
    how = rng.integers(4)
    if how == 0 and len(place) > 1:
        del place[key]
    elif how == 1 and isinstance(place, dict):
        place[choice(rng, TEXTS)] = place.pop(key)
    elif how == 2:
        place[key] = _number_like(rng, place[key])
    else:
        place[key] = _any_value(rng)
    return json.dumps(tree, indent=1).encode()


def zip_member(*damages):
    """Damage to one member of a zip archive, which is then packed again with the right checksum."""

    def change(rng, data, other):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {info.filename: archive.read(info) for info in archive.infolist()}
        name = sorted(members)[int(rng.integers(len(members)))]
        members[name] = choice(rng, damages)(rng, members[name], members[sorted(members)[0]])
        if rng.random() < 0.1:
            members[choice(rng, (f"{OUTSIDE}/new.npy", "/new.npy", "phasors", "x\x00y"))] = members.pop(name)
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", choice(rng, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
            for member, content in members.items():
                archive.writestr(member, content)
        return packed.getvalue()

    return change


def npy_header(rng, data, other):
    """Another shape, type or order in the header of a .npy array, whose length stays right."""
    size = struct.unpack("<H", data[8:10])[0]
    header = replace_a_token(rng, data[10 : 10 + size], other)
    return data[:8] + struct.pack("<H", len(header) % 2**16) + header + data[10 + size :]


def safetensors_header(*damages):
    """Damage to the JSON header of a safetensors file, whose length stays right."""

    def change(rng, data, other):
        size = struct.unpack("<Q", data[:8])[0]
        header = choice(rng, damages)(rng, data[8 : 8 + size], other)
        return struct.pack("<Q", len(header)) + header + data[8 + size :]

    return change


def exr_attribute(rng, data, other):
    """One attribute of an EXR header with another name, type, size, or number in its value."""
    attributes, end = _exr_attributes(data)
    index = int(rng.integers(len(attributes)))
    name, kind, size, value = attributes[index]
    how = rng.integers(6)
    if how == 0:
        name = choice(rng, (b"channels", b"tiles", b"chunkCount", b"night.bin_count", b"\xff", b"x" * 300))
    elif how == 1:
        kind = choice(rng, (b"string", b"chlist", b"box2i", b"tiledesc", b"stringvector", b"\xc3", b"float"))
    elif how == 2:
        size = choice(rng, NUMBERS) % 2**32
    elif how == 3:
        attributes.pop(index)
    else:
        place = int(rng.integers(max(1, len(value) - 3)))
        number = (choice(rng, NUMBERS) % 2**32).to_bytes(4, "little")
        value = value[:place] + number + value[place + 4 :]
    if how != 3:
        attributes[index] = (name, kind, size, value)
    header = b"".join(n + b"\x00" + k + b"\x00" + struct.pack("<I", s) + v for n, k, s, v in attributes)
    return data[:8] + header + data[end:]


def _exr_attributes(data):
    """(name, type, size, value) of each attribute, and the place after the last one."""
    found, place = [], 8  # after the magic number and the version
    while data[place]:
        name, kind = data[place : place + 600].split(b"\x00")[:2]
        place += len(name) + len(kind) + 2
        size = struct.unpack("<I", data[place : place + 4])[0]
        found.append((name, kind, size, data[place + 4 : place + 4 + size]))
        place += 4 + size
    return found, place


def yaml_value(rng, data, other):
    """A value of a YAML file with a tag of its own, or lists that grow tenfold with every line."""
    lines = data.splitlines(keepends=True)
    place = int(rng.integers(len(lines)))
    key = lines[place].split(b":")[0]
    kind = choice(rng, (b"python/object/apply:os.system", b"timestamp", b"bool", b"int", b"binary", b"set"))
    bomb = b"&l0 [x]\n" + b"".join(
        key[: len(key) - len(key.lstrip())]
        + b"l%d: &l%d [%s]\n" % (n, n, b", ".join([b"*l%d" % (n - 1)] * 10))
        for n in range(1, 12)
    )
    lines[place] = (
        key + b": " + choice(rng, (b"!!" + kind + b" x\n", b"2001-99-99\n", b"1" * 5000 + b"\n", bomb))
    )
    return b"".join(lines)


def hdf5_link(rng, data, other):
    """One data set of an HDF5 file is a link, lies in other files, or claims another shape."""
    file = io.BytesIO(data)
    with h5py.File(file, "r+") as content:
        name = sorted(content)[int(rng.integers(len(content)))]
        array = content[name][()]
        del content[name]
        how = rng.integers(5)
        secret = f"{OUTSIDE}/secret.h5"
        if how == 0:
            content[name] = h5py.ExternalLink(secret, "/phasors")
        elif how == 1:
            content[name] = h5py.SoftLink(choice(rng, (f"/{name}", "/", "/nothing")))
        elif how == 2:
            stored = [(f"{OUTSIDE}/keep.txt", 0, array.nbytes)]
            content.create_dataset(name, array.shape, array.dtype, external=stored)
        elif how == 3:
            layout = h5py.VirtualLayout(array.shape, array.dtype)
            layout[...] = h5py.VirtualSource(secret, "phasors", array.shape)
            content.create_virtual_dataset(name, layout)
        else:
            shape = [
                choice(rng, (*array.shape, *(n for n in NUMBERS if 0 <= n < 2**63))) for _ in array.shape
            ]
            _claim(content, name, shape, array.dtype)
    return file.getvalue()


def _claim(content, name, shape, dtype):
    """A data set of any size that occupies nothing."""
    try:
        content.create_dataset(name, shape, dtype, chunks=(1,) * len(shape), compression="gzip")
    except (ValueError, OSError, TypeError, RuntimeError, OverflowError):  # a size that HDF5 itself refuses
        content[name] = [1.0]


def _any_place(rng, tree):
    """A dictionary or list within the tree, and a key of it."""
    places = []
    waiting = [tree]
    while waiting:
        each = waiting.pop()
        keys = list(each) if isinstance(each, dict) else range(len(each))
        places += [(each, key) for key in keys]
        waiting += [each[key] for key in keys if isinstance(each[key], dict | list)]
    return places[int(rng.integers(len(places)))]


def _number_like(rng, value):
    """A slightly or wildly other number; other values become numbers."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return choice(rng, NUMBERS)
    near = (value + 1, -value, value * 1e9, value / 7, str(value))
    return choice(rng, (*near, float("nan"), float("inf"), *NUMBERS))


def _any_value(rng):
    deep = []
    for _ in range(int(choice(rng, (3, 900)))):
        deep = [deep]
    text = choice(rng, TEXTS)
    return choice(rng, (None, True, False, [], {}, [None], deep, 1e308, float("nan"), text, text))


NPZ = (*ANY_BYTES, *[zip_member(npy_header)] * 4, *[zip_member(*ANY_BYTES)] * 4)
CHECKPOINT = (*ANY_BYTES, *[zip_member(*ANY_BYTES)] * 8)
JSON = (*[json_tree] * 8, *ANY_TEXT)
NPY = (*ANY_BYTES, *[npy_header] * 6)
SAFETENSORS = (*ANY_BYTES, *[safetensors_header(json_tree, replace_a_token)] * 4)
EXR = (*ANY_BYTES, *[exr_attribute] * 6)
YAML = (*ANY_TEXT, *[yaml_value] * 4)
HDF5 = (*ANY_BYTES, *[hdf5_link] * 3)
