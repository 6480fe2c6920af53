"""``night-render export`` to Zarr: the arrays of the HDF5 file, read with zarr and numpy alone."""

import json
import shutil
import subprocess
import sys
import threading

import h5py
import numpy as np
import pytest
from full_disk import file_size_limit, small_disk
from night_commands import night_here, refusal

from render.products import zarr_copy
from render.products.conversion import ExportError
from render.products.dataset_export import export_dataset
from render.products.zarr_copy import digest_of_folder
from scenegen import open_dataset


@pytest.fixture(scope="module")
def folder(seven_renders, tmp_path_factory):
    out = tmp_path_factory.mktemp("zarr") / "seven.zarr"
    done = night_here("night-render", "export", seven_renders, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["bytes"], result["sha256"]) == digest_of_folder(out)
    assert [file.name for file in out.parent.iterdir()] == ["seven.zarr"]
    return out


def test_arrays_and_attributes_are_those_of_the_hdf5_file(folder, exported):
    import zarr

    root = zarr.open_group(folder, mode="r")
    names = []
    with h5py.File(exported) as file:
        file.visit(names.append)
        names = [name for name in names if isinstance(file[name], h5py.Dataset)]
        for name in names:
            item = file[name]
            text = h5py.check_string_dtype(item.dtype) is not None
            np.testing.assert_array_equal(root[name][()], (item.asstr() if text else item)[()])
            assert dict(root[name].attrs) == dict(item.attrs)
            assert text or root[name].dtype == item.dtype
        assert dict(root.attrs) == {key: getattr(v, "item", lambda v=v: v)() for key, v in file.attrs.items()}
    assert len(names) == 20
    assert sum(1 for _ in folder.rglob(".zarray")) == len(names)


def test_zarr_and_numpy_alone_read_it_and_find_damage(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "paper.zarr")
    code = """
import json, sys
import zarr
root = zarr.open_group("paper.zarr", mode="r")
z = root["phasors"][0]
scene = json.loads(str(root["scene"][0]))
assert not {"scenegen", "itof", "render", "model"} & set(sys.modules)
print(z.shape, z.dtype, root["frequencies_hz"][:].tolist(), scene["index"])
print(sorted(root["splits"].array_keys()), root["phasors"].attrs["axes"], root.attrs["format"])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    first, second = done.stdout.splitlines()
    assert first == "(18, 24, 3) complex64 [20000000.0, 50000000.0, 60000000.0] 0"
    assert second == "['test', 'train', 'validation'] N,H,W,F NIGHT dataset"
    import zarr

    copy = shutil.copytree(folder, tmp_path / "damaged.zarr")
    chunk = next((copy / "phasors").glob("0.*"))
    content = bytearray(chunk.read_bytes())
    content[len(content) // 2] ^= 1
    chunk.write_bytes(content)
    with pytest.raises(RuntimeError, match=r"[Zz]std"):
        zarr.open_group(copy, mode="r")["phasors"][()]


def test_the_same_dataset_gives_the_same_bytes_and_sha256sum_the_same_hash(folder, seven_renders, tmp_path):
    again = export_dataset(open_dataset(seven_renders), tmp_path / "again.zarr")
    assert (again.bytes, again.sha256) == digest_of_folder(folder)
    line = "find . -type f | LC_ALL=C sort | xargs sha256sum | sha256sum"  # of docs/reference/files.md
    listed = subprocess.run(["/bin/sh", "-c", line], cwd=folder, capture_output=True, text=True, check=True)
    assert listed.stdout.split()[0] == again.sha256
    everything = b"".join(file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file())
    assert str(seven_renders).encode() not in everything


def test_chunks_hold_whole_scenes(folder, monkeypatch, seven_renders, tmp_path):
    import zarr

    assert zarr.open_group(folder, mode="r")["phasors"].chunks == (7, 18, 24, 3)
    monkeypatch.setattr(zarr_copy, "_CHUNK_BYTES", 3 * 18 * 24 * 3 * 8)
    export_dataset(open_dataset(seven_renders), tmp_path / "cut.zarr")
    cut, whole = (zarr.open_group(each, mode="r") for each in (tmp_path / "cut.zarr", folder))
    assert cut["phasors"].chunks == (3, 18, 24, 3)
    np.testing.assert_array_equal(cut["phasors"][()], whole["phasors"][()])


def test_another_thread_may_use_h5py_while_zarr_writes(monkeypatch, exported, seven_renders, tmp_path):
    """As garbage of h5py that a thread of zarr happens to collect does; it needs h5py's lock."""
    import zarr

    create = zarr.Group.create_array

    def create_array(*arguments, **options):
        other = threading.Thread(target=lambda: h5py.File(exported).close(), daemon=True)
        other.start()
        other.join(timeout=300)
        assert not other.is_alive()
        return create(*arguments, **options)

    monkeypatch.setattr(zarr.Group, "create_array", create_array)
    export_dataset(open_dataset(seven_renders), tmp_path / "x.zarr")


def test_without_the_package_the_name_of_its_extra_is_given(monkeypatch, seven_renders, tmp_path):
    monkeypatch.setitem(sys.modules, "zarr", None)
    sentence = refusal("night-render", "export", seven_renders, "--out", tmp_path / "x.zarr")
    assert "pip install 'night-nlos[export]'" in sentence
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_found_no_room_is_named_and_leaves_nothing(folder, exported, seven_renders, tmp_path):
    dataset = open_dataset(seven_renders)
    largest = max(file.stat().st_size for file in folder.rglob("*"))
    for limit in (0, 600, exported.stat().st_size // 2, largest // 2):
        out = tmp_path / str(limit) / "x.zarr"
        with file_size_limit(limit), pytest.raises(ExportError) as refused:
            export_dataset(dataset, out)
        assert str(refused.value) == f"cannot write {out}: File too large"
        assert list(out.parent.iterdir()) == []


def test_a_full_disk_ends_the_command_in_one_sentence(folder, exported, seven_renders, tmp_path):
    with small_disk(tmp_path / "disk") as resize:
        resize(exported.stat().st_size + 20_000)  # room for the HDF5 file, and not for what is made of it
        out = tmp_path / "disk" / "x.zarr"
        sentence = refusal("night-render", "export", seven_renders, "--out", out)
        assert sentence == f"cannot write {out}: No space left on device"
        assert list(out.parent.iterdir()) == []
