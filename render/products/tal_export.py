"""Export of a transient as an HDF5 file for y-tal, a toolbox of the Graphics and Imaging Lab in Zaragoza.

Source: ``NLOSCaptureData`` in y-tal 0.20 (https://github.com/diegoroyo/tal), file format HDF5_TAL.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from disk import PathLike
from itof import TransientLayout, TransientReader, pixel_rays
from render.products.conversion import ExportError, exported_file, open_transient
from render.products.deferred_error_file import hdf5_file
from render.products.rendered_scene import rendered_scene
from scenegen import TRANSIENT_FILE, Dataset, Scene, camera_axes, rotation_matrix, wall_normal

if TYPE_CHECKING:
    import h5py

# Enumerations of tal, with the names in its files.
_H_FORMAT = {"UNKNOWN": 0, "T_Sx_Sy": 1, "T_Lx_Ly_Sx_Sy": 2, "T_Si": 3, "T_Li_Si": 4}
_GRID_FORMAT = {"UNKNOWN": 0, "N_3": 1, "X_Y_3": 2}
_VOLUME_FORMAT = {"UNKNOWN": 0, "N_3": 1, "X_Y_Z_3": 2, "X_Y_3": 3}
_CHUNK_BINS, _CHUNK_COLUMNS, _CHUNK_ROWS = 250, 32, 8  # 256 kB; the cache of HDF5 has 1 MB
_LASER_NOTE = (
    "The projector lights its whole field at once, but tal knows only laser points: laser_grid_xyz is the "
    "one point on the projector's optical axis. A reconstruction that assumes this is the only lit point is "
    "blurred and displaced, because light comes from all of the lit wall."
)


def export_tal(dataset: Dataset, scene_id: str, out: PathLike) -> None:
    """Write the ``transient.exr`` of a scene as a capture that ``tal.io.read_capture`` reads.

    ============================  ==========================================================================
    ``H``                         (T, W, H) float32, axes T_Sx_Sy: time, image column from the left, image
                                  row from the top; gzip
    ``sensor_xyz, laser_xyz``     (3,) camera and projector
    ``sensor_grid_xyz``           (W, H, 3) points where the rays of pixel centres meet the plane of the
                                  relay wall
    ``laser_grid_xyz``            (1, 1, 3) point where the optical axis of the projector meets it
    ``*_grid_normals``            normal of the relay wall at these points, towards camera and object
    ``delta_t``                   bin width, optical path length
    ``t_start``                   start of the first bin (tal computes the bin as the integer part of
                                  (length - t_start) / delta_t)
    ``scene_info``                YAML: units, provenance, and the difference from a capture with laser points
    ============================  ==========================================================================

    Coordinates and lengths are metres, in the world axes of the scene. Path lengths are from projector to
    camera (``t_accounts_first_and_last_bounces``). ``H`` includes the direct return of the wall.

    tal knows only laser points, but our projector lights its whole field at once. The capture has one point,
    on the optical axis of the projector. Reconstructions assume that it is the only source. They are blurred
    and displaced, because light comes from all of the lit wall.

    Raises
    ------
    ExportError : the scene has no transient, its files are not those that were rendered, the camera or the
        projector looks past the relay wall, or the file cannot be written.
    """
    import h5py

    scene = rendered_scene(dataset, scene_id)
    with open_transient(dataset, scene_id) as reader:
        fields = _geometry(scene, reader.layout)
        with exported_file(out) as partial, hdf5_file(partial) as (file, stop_if_needed):
            for name, value in fields.items():
                file[name] = value
            for name, members, chosen in (
                ("H_format", _H_FORMAT, "T_Sx_Sy"),
                ("sensor_grid_format", _GRID_FORMAT, "X_Y_3"),
                ("laser_grid_format", _GRID_FORMAT, "X_Y_3"),
                ("volume_format", _VOLUME_FORMAT, "UNKNOWN"),
            ):
                kind = h5py.enum_dtype(members, basetype="i")
                file.create_dataset(name, data=np.array([members[chosen]], "i"), dtype=kind)
            file["delta_t"] = reader.layout.bin_width_m
            file["t_start"] = reader.layout.start_opl_m
            file["t_accounts_first_and_last_bounces"] = True
            file["scene_info"] = _scene_info(dataset, scene, reader)
            for _ in _written_bins(file, reader):
                stop_if_needed()


def _written_bins(file: h5py.File, reader: TransientReader) -> Iterator[int]:
    """Write ``H`` in blocks of image rows that are whole chunks, so that each chunk is compressed once.

    Yields the number of rows that are written, after each block.
    """
    axis = reader.layout
    shape = (axis.bin_count, axis.width, axis.height)
    chunks = tuple(map(min, shape, (_CHUNK_BINS, _CHUNK_COLUMNS, _CHUNK_ROWS)))
    bins = file.create_dataset(
        "H", shape, np.float32, chunks=chunks, compression="gzip", compression_opts=1, shuffle=True
    )
    step = max(1, axis.rows_per_block // chunks[2]) * chunks[2]
    row = 0
    for block in reader.row_blocks(step):  # (rows, W, T)
        bins[:, :, row : row + len(block)] = block.transpose(2, 1, 0)
        row += len(block)
        yield row


def _geometry(scene: Scene, layout: TransientLayout) -> dict[str, NDArray[np.float32]]:
    """Positions and normals by name of the field, (3,) or (X, Y, 3) float32, metres."""
    camera, emitter, wall = scene.camera, scene.emitter, scene.relay_wall
    rays = pixel_rays(layout.width, layout.height, camera.horizontal_fov_deg) @ camera_axes(camera)
    axis = -rotation_matrix(emitter.rotation_deg)[:, 2]  # Blender looks along its own -z
    sensor_grid = _on_wall(scene, camera.location_m, rays.swapaxes(0, 1), "the camera")  # (W, H, 3)
    laser_grid = _on_wall(scene, emitter.location_m, axis[None, None], "the projector")  # (1, 1, 3)
    normal = wall_normal(wall)
    fields: dict[str, Any] = {
        "sensor_xyz": camera.location_m,
        "sensor_grid_xyz": sensor_grid,
        "sensor_grid_normals": np.broadcast_to(normal, sensor_grid.shape),
        "laser_xyz": emitter.location_m,
        "laser_grid_xyz": laser_grid,
        "laser_grid_normals": np.broadcast_to(normal, laser_grid.shape),
    }
    return {name: np.asarray(value, np.float32) for name, value in fields.items()}


def _on_wall(
    scene: Scene, origin_m: tuple[float, float, float], rays: NDArray[np.float64], who: str
) -> NDArray[np.float64]:
    """(..., 3) points where rays from `origin_m` meet the plane of the relay wall, metres."""
    origin, normal = np.array(origin_m), wall_normal(scene.relay_wall)
    with np.errstate(divide="ignore", invalid="ignore"):
        length_m = ((np.array(scene.relay_wall.location_m) - origin) @ normal) / (rays @ normal)
    if not (np.isfinite(length_m) & (length_m > 0)).all():
        raise ExportError(
            f"scene {scene.id}: {who} looks past the plane of the relay wall, but a capture for tal needs "
            "a point on the wall for every pixel"
        )
    points: NDArray[np.float64] = origin + rays * length_m[..., None]
    return points


def _scene_info(dataset: Dataset, scene: Scene, reader: TransientReader) -> str:
    import yaml

    info = {
        "original_format": f"{TRANSIENT_FILE} of NIGHT {version('night-nlos')}",
        "scene_id": scene.id,
        "object_class": scene.object_class,
        "split": scene.split,
        "dataset_seed": scene.dataset_seed,
        "dataset_generator": f"{dataset.index.generator} {dataset.index.generator_version}",
        "frequencies_hz": list(dataset.preset.itof.frequencies_hz),
        "units": {
            "H": "radiance per bin, W m^-2 sr^-1, for a projector of irradiance scale 1",
            "lengths": "metres; delta_t and t_start are optical path length",
            "axes": "world, z up; Sx is the image column from the left, Sy the image row from the top",
        },
        "splat": reader.attributes.get("splat", "point"),
        "laser": _LASER_NOTE,
        "attributes": reader.attributes,
    }
    text: str = yaml.safe_dump(info, sort_keys=False)
    return text
