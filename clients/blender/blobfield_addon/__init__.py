"""Blender add-on: surfaces of blobfieldd, from empties, curves and documents,
remeshed as they change."""

bl_info = {
    "name": "Blobfield",
    "description": "Gradient-based implicit blends, meshed by blobfieldd",
    "version": (0, 4, 0),
    "blender": (3, 4, 0),
    "location": "3D View > Sidebar > Blobfield",
    "category": "Mesh",
}

from . import live, panel, preferences  # noqa: E402


def register():
    preferences.register()
    panel.register()
    live.register()


def unregister():
    live.unregister()
    panel.unregister()
    preferences.unregister()
