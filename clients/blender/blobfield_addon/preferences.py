"""What is the user's, and not a .blend file's: the token, and for whom.

A file may name any server, and be live as soon as it is opened: the token goes
only to the one that the user has named here.
"""
import os

import bpy
from bpy.props import StringProperty

from .wire import blobfield


class BlobfieldPreferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    server: StringProperty(
        name="Token is for",
        description="The one server that gets the token; BLOBFIELD_URL of "
        f"the environment, or {blobfield.DEFAULT_URL}, if it is empty")
    token: StringProperty(
        name="Token", subtype="PASSWORD",
        description="For a server that asks for one; BLOBFIELD_TOKEN of the "
        "environment if it is empty. Kept in Blender's preferences, readable "
        "there, and not in .blend files")

    def draw(self, _):
        self.layout.prop(self, "token")
        self.layout.prop(self, "server")


def token(url):
    """For Client(url, token=): "" is none."""
    addon = bpy.context.preferences.addons.get(__package__)
    own = addon and addon.preferences
    server = (getattr(own, "server", "") or os.environ.get("BLOBFIELD_URL")
              or blobfield.DEFAULT_URL)
    if _plain(url) != _plain(server):
        return ""
    return getattr(own, "token", "") or os.environ.get("BLOBFIELD_TOKEN", "")


def _plain(url):
    return (url if "//" in url else "http://" + url).rstrip("/").lower()


def register():
    bpy.utils.register_class(BlobfieldPreferences)


def unregister():
    bpy.utils.unregister_class(BlobfieldPreferences)
