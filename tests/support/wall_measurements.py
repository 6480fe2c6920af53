"""Measurements of relay walls, rendered and in closed form, and what can be wrong with a measurement."""

import numpy as np

from itof import pixel_rays, read_image
from itof.wall.expected_wall import ExpectedWall, radial_depth_of_plane
from model.data.corner import wall_view

WIDTH, HEIGHT, FOV_DEG = 26, 18, 60.0
FREQUENCIES_HZ = (20e6, 50e6, 60e6)
SLANTED = np.array([-0.6, 0.1, 0.7])  # 1/m in camera axes: a wall to the left, 1.1 m away, and a bit below


def wall_of_plane(plane_per_m=SLANTED, frequencies_hz=FREQUENCIES_HZ, width=WIDTH, height=HEIGHT):
    """A wall as the camera at the origin sees it; the phases are those of the pixel centres."""
    rays = pixel_rays(width, height, FOV_DEG)
    wall = ExpectedWall(tuple(frequencies_hz), np.empty(0), rays, plane_per_m)
    return ExpectedWall(wall.frequencies_hz, returned(wall, plane_per_m), rays, plane_per_m)


def returned(wall, plane_per_m, offsets_rad=0.0):
    """(H, W, F) return of a wall in another place, seen by the camera of `wall`."""
    depth_m = radial_depth_of_plane(wall.rays, plane_per_m)[..., None]
    cosine = wall.rays @ plane_per_m / np.linalg.norm(plane_per_m)
    return cosine[..., None] / depth_m**2 * np.exp(1j * (wall.slope * depth_m + offsets_rad))


def moved(plane_per_m, distance_m, tilt_deg):
    """The plane farther away by `distance_m` after a turn by `tilt_deg` about an axis within it."""
    distance = 1 / np.linalg.norm(plane_per_m)
    normal = plane_per_m * distance
    within = np.cross(normal, [0.0, 1.0, 0.0])
    within /= np.linalg.norm(within)
    angle = np.radians(tilt_deg)
    return (np.cos(angle) * normal + np.sin(angle) * within) / (distance + distance_m)


def expected_wall_of(dataset):
    """The relay wall of a dataset where its camera should see it, at the size of its renders."""
    view, frequencies_hz = wall_view(dataset), dataset.preset.itof.frequencies_hz
    height, width = phasors_of(dataset, dataset.ids()[0]).shape[:2]
    place = (view.camera_axes, view.camera_location_m, view.wall_point_m, view.wall_normal)
    direct = view.direct_phasors(width, height, frequencies_hz)
    return ExpectedWall.of_camera(direct, frequencies_hz, view.horizontal_fov_deg, *place)


def phasors_of(dataset, scene_id):
    return read_image(dataset.render_folder(scene_id) / "itof.exr").phasors()[0]


def noise(shape, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def farther(z, wall, shift_m):
    """The measurement with the light of each pixel delayed as by a wall that is farther away by `shift_m`."""
    delay_m = shift_m * wall.radial_depth_m * np.linalg.norm(wall.plane_per_m)  # moved along the normal
    return z * np.exp(1j * wall.slope * delay_m[..., None])


def exchanged(z, one, other):
    order = list(range(z.shape[-1]))
    order[one], order[other] = order[other], order[one]
    return z[..., order]


def noisy_frequency(z, wall):
    z = z.copy()
    z[..., 0] = noise(z.shape[:2])
    return z


def rounded_to_8_bits(z, wall):
    step = np.abs(z).max() / 127
    return step * (np.round(z.real / step) + 1j * np.round(z.imag / step))


def half_shifted(z, wall):
    half = len(z) // 2
    return np.concatenate([z[:half], np.roll(z[half:], 1, axis=1)])


def of_one_depth(z, wall):
    depth_m = (np.angle(z[..., 0]) % (2 * np.pi)) / wall.slope[0]
    return np.abs(z[..., :1]) * np.exp(1j * wall.slope * depth_m[..., None])


def planes_mixed(z, wall):
    """Planes Re, Re, Re, Im, Im, Im taken as Re, Im, Re, Im, Re, Im."""
    planes = np.concatenate([z.real, z.imag], axis=-1)
    return planes[..., ::2] + 1j * planes[..., 1::2]


# What is done to (phasors, wall) of three frequencies, the code of the finding, and words of its sentence.
DEFECTS = {
    "noise": (lambda z, w: noise(z.shape), "no-wall", "are noise"),
    "random phases": (lambda z, w: np.abs(z) * np.exp(1j * np.angle(noise(z.shape))), "no-wall", "are noise"),
    "ones": (lambda z, w: np.ones_like(z), "no-wall", "the phase is the same in all pixels"),
    "one phase": (lambda z, w: np.abs(z) * np.exp(0.3j), "no-wall", "the phase is the same in all pixels"),
    "darkness": (lambda z, w: 0 * z, "no-wall", "no pixel holds light"),
    "no amplitude": (lambda z, w: z / np.abs(z), "even-amplitude", "the same in all pixels"),
    "conjugated": (lambda z, w: z.conj(), "convention", "the phase falls with distance: conjugate?"),
    "negative": (lambda z, w: -z, "convention", "the wrong sign"),
    "real and imaginary exchanged": (lambda z, w: 1j * z.conj(), "convention", "real and imaginary part"),
    "real part negative": (lambda z, w: -z.conj(), "convention", "the real part has the wrong sign"),
    "quarter turn": (lambda z, w: 1j * z, "convention", "too large by a quarter turn"),
    "20 and 60": (lambda z, w: exchanged(z, 0, 2), "convention", "frequencies 20 and 60 MHz seem exchanged"),
    "50 and 60": (lambda z, w: exchanged(z, 1, 2), "convention", "frequencies 50 and 60 MHz seem exchanged"),
    "order": (lambda z, w: z[..., [1, 2, 0]], "convention", "20, 50, 60 MHz look like 50, 60, 20 MHz"),
    "columns": (lambda z, w: z[:, ::-1], "convention", "the image seems mirrored left to right"),
    "half a turn": (lambda z, w: z[::-1, ::-1], "convention", "the image seems turned by half a turn"),
    "column by column": (
        lambda z, w: z.swapaxes(0, 1).reshape(z.shape),
        "convention",
        "stored column by column",
    ),
    "phase of twice the path": (
        lambda z, w: np.abs(z) * np.exp(2j * np.angle(w.direct)),
        "convention",
        "the phases are twice those of the wall",
    ),
    "phase of half the path": (
        lambda z, w: np.abs(z) * np.exp(0.5j * w.slope * w.radial_depth_m[..., None]),
        "convention",
        "the phases are half those of the wall: frequencies_hz too large",
    ),
    "one conjugated": (
        lambda z, w: np.concatenate([z[..., :2], z[..., 2:].conj()], axis=-1),
        "convention",
        "at 60 MHz: the phase falls with distance",
    ),
    "one frequency is noise": (noisy_frequency, "no-wall", "the phases at 20 MHz are noise"),
    "5 cm farther": (lambda z, w: farther(z, w, 0.05), "wall-moved", "cm farther away"),
    "5 cm nearer": (lambda z, w: farther(z, w, -0.05), "wall-moved", "cm nearer"),
    "70 cm farther": (lambda z, w: farther(z, w, 0.7), "wall-moved", "cm farther away"),
    "uncalibrated": (lambda z, w: z * np.exp(1j * np.array([0.5, 1.4, -2.0])), "phase-offsets", "off by"),
    "20 mrad": (lambda z, w: z * np.exp(0.02j), "phase-offsets", "off by"),
    "much noise": (lambda z, w: z * (1 + 0.2 * noise(z.shape)), "scatter", "too noisy?"),
}

# The same of what is no image of a scene, whatever it shows.
IMAGE_DEFECTS = {
    "one row": (lambda z, w: np.repeat(z[9:10], len(z), 0), "convention", "rows of the image are copies"),
    "rolled": (lambda z, w: np.roll(z, 1, 1), "convention", "rolled: its first 1 columns"),
    "rows in pairs": (
        lambda z, w: z.reshape(-1, 2, *z.shape[1:])[:, ::-1].reshape(z.shape),
        "convention",
        "rows of the image seem exchanged in pairs",
    ),
    "half shifted": (half_shifted, "convention", "a seam near row"),
    "8 bits": (rounded_to_8_bits, "no-hidden-light", "different numbers"),
    "one depth": (of_one_depth, "no-hidden-light", "no hidden light can be in it"),
    "planes mixed": (planes_mixed, "convention", "the real part at 20 MHz and the imaginary part at 50 MHz"),
}
