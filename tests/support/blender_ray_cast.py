"""The geometry check of `scenegen.geometry_check` by rays in Blender: its slow, independent reference."""

from scenegen.making.blender_shapes import world_mesh
from scenegen.making.blender_start import BlenderVector
from scenegen.mitsuba_description import hidden_names


def ray_cast_refusal(maker, scene):
    """Why a scene is impossible, or None, from a ray to every outermost vertex."""
    from mathutils.bvhtree import BVHTree

    with maker._built(scene) as objects:
        camera = objects["camera"].matrix_world.translation
        relay = objects["relay_wall"].matrix_world
        facing, point = relay.to_3x3() @ BlenderVector((0, 0, 1)), relay.translation
        middle = world_mesh(objects["middle_wall"])
        blocker = BVHTree.FromPolygons([tuple(v.co) for v in middle.vertices], [[0, 1, 3, 2]])
        for name, part in zip(hidden_names(scene), scene.hidden_objects, strict=True):
            shape = part.shape.removeprefix("mesh:")
            vertices = world_mesh(objects[name]).vertices
            mesh = maker.meshes.get(part.shape)
            for index in range(len(vertices)) if mesh is None else mesh.outermost.tolist():
                vertex = vertices[index]
                if (vertex.co - point).dot(facing) < 1e-3:
                    return f"{shape} ({name}) reaches through the relay wall"
                ray = vertex.co - camera
                if blocker.ray_cast(camera, ray.normalized(), ray.length)[0] is None:
                    return f"{shape} ({name}) shows beside the middle wall"
    return None
