"""Makes the scenes of a dataset: samples that fit the room, meshes in Blender, Mitsuba scene files.

Only ``night-gen`` needs this package. Its modules named ``blender...`` are the only ones that use `bpy`; they
are imported late. It may import the rest of `scenegen`, which does not import it.
"""
