"""Many lights against the path tracer: agreement within its noise, for all emitters and with shadows."""

import numpy as np
import pytest
from many_light_scenes import (
    CAMERA_LOCATION_M,
    FORWARD,
    LAYOUT,
    SHAPES,
    SMALL,
    Corner,
    assert_agrees_with_paths,
    ball,
    box,
    measure,
    path_phasors,
    quad,
    rough_plastic,
)


@pytest.mark.parametrize(
    ("layout", "lights"),
    [(SMALL, 1024), pytest.param(LAYOUT, 2**15, marks=pytest.mark.thorough)],
    ids=["small", "large"],
)
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.long if name in ("sphere", "cube") else ()) for name in SHAPES],
)
def test_many_lights_agree_with_the_path_tracer_within_its_noise(four_shapes, variant, name, layout, lights):
    image = measure(four_shapes[name], variant, lights=lights, layout=layout)
    # 12 x 2048 paths a pixel know the sum of the large image to 0.4 % (1 % of the concave plane's, which
    # returns little) and that of the small one, of a quarter of the pixels, to twice that.
    runs = path_phasors(four_shapes[name], variant, seeds=range(12), spp=2048, layout=layout)
    assert_agrees_with_paths(image, runs)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["spot", "point", "area"])
def test_other_emitters_than_a_projector_agree_with_the_path_tracer(variant, tmp_path, kind):
    import mitsuba as mi

    def facing_the_wall(height_m):
        origin = CAMERA_LOCATION_M + np.array([0, 0, height_m])
        return mi.ScalarTransform4f().look_at(origin.tolist(), (origin + FORWARD).tolist(), [0, 0, 1])

    lamp = facing_the_wall(0.3) @ mi.ScalarTransform4f().scale(0.05)
    emitter = {
        "spot": {"type": "spot", "to_world": facing_the_wall(0), "cutoff_angle": 25.0, "beam_width": 20.0},
        "point": {"type": "point", "position": CAMERA_LOCATION_M.tolist()},
        "area": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": 50.0}},
    }[kind]
    scene = Corner((ball(),), other_emitter=emitter).load(tmp_path)
    image = measure(scene, variant, lights=2048, layout=SMALL)
    total = image.hidden.sum(axis=(0, 1))
    paths = path_phasors(scene, variant, seeds=range(10), spp=2048, layout=SMALL)
    # The direct part is the path tracer's own: a lamp with an extent is random in both.
    direct = path_phasors(scene, variant, seeds=range(1), spp=2048, layout=SMALL, max_bounces=1)[0]
    runs = (paths - direct).sum(axis=(1, 2)) / total
    sigma = runs.real.std(axis=0, ddof=1) / np.sqrt(len(runs))
    # Student's t with 9 degrees of freedom passes 5.5 once in 2500; the lights' own error is 0.5 %.
    assert np.all(np.abs(runs.real.mean(axis=0) - 1) < 5.5 * sigma + 0.005)
    assert np.all(sigma < 0.02)


@pytest.mark.long
def test_an_object_half_behind_a_black_blocker_gives_less_and_what_paths_say(variant, tmp_path):
    blocker = quad((0.75, 0.9, 1.0), (0.75, 1.6, 1.0), (0.75, 1.6, 2.2), (0.75, 0.9, 2.2))
    free = Corner((ball(),), wall_bsdf=rough_plastic(0.5))
    clear = measure(free.load(tmp_path), variant, layout=SMALL)
    scene = free.but(blockers=(blocker,)).load(tmp_path)
    shaded = measure(scene, variant, layout=SMALL)
    share = np.abs(shaded.hidden).sum() / np.abs(clear.hidden).sum()
    assert 0.2 < share < 0.9  # so that the shadow matters
    assert_agrees_with_paths(shaded, path_phasors(scene, variant, seeds=range(12), spp=1024, layout=SMALL))


@pytest.mark.long
def test_objects_shade_each_other(variant, tmp_path):
    near, far = ball(radius_m=0.15, centre=(0.7, 0.9, 1.6)), box(centre=(1.3, 1.0, 1.6))
    corner = Corner((near, far), wall_bsdf=rough_plastic(0.5))
    scene = corner.load(tmp_path)
    both = measure(scene, variant, layout=SMALL)
    alone = [
        measure(corner.but(hidden=(one,)).load(tmp_path), variant, layout=SMALL).hidden for one in (near, far)
    ]
    assert np.abs(both.hidden).sum() < 0.97 * np.abs(sum(alone)).sum()  # so that shadows matter
    assert_agrees_with_paths(both, path_phasors(scene, variant, seeds=range(12), spp=1024, layout=SMALL))
