"""Making the scenes of a dataset: drawing them, their meshes in Blender, their Mitsuba files.

Only `night-gen` needs this wing. The modules named `blender...` are the only ones that import `bpy`; they are
imported late. May import the rest of `scenegen`, which never imports this wing.
"""
