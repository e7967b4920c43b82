"""Properties, operators and the panel in the sidebar of the 3D view."""
import bpy
from bpy.props import (BoolProperty, EnumProperty, FloatProperty, IntProperty,
                       PointerProperty, StringProperty)

from . import live, preferences, tree
from .wire import blobfield

OPERATORS = [
    ("camel", "Camel", "Blends where surfaces meet at an angle, not where "
     "they run alongside: no bulge, no reaching across gaps"),
    ("organic", "Organic", "Like Camel, rounder where surfaces meet at an "
     "acute angle"),
    ("contact", "Contact", "Bulges around joints, as soft things pressed "
     "together do"),
    ("blend", "Blend", "Blends at every angle, as the classic operators do"),
    ("clean", "Clean", "Sharp at the surface, smooth everywhere else"),
    ("sharp", "Sharp", "Maximum and minimum"),
    ("sum", "Sum", "Fields are added (cuts are clean)"),
]
KINDS = [
    ("AUTO", "Automatic", "By type and display: empties are points, boxes, "
     "circles, cones; curves are tubes; mesh cubes are boxes"),
    ("POINT", "Point", "Soft, of the radius of the empty's display"),
    ("SPHERE", "Sphere", "Solid, of the radius of the empty's display"),
    ("BOX", "Box", "Solid; a mesh's bounding box"),
    ("CIRCLE", "Circle", "A soft ring about the empty's Y axis"),
    ("TORUS", "Torus", "A solid ring about the empty's Y axis"),
    ("CONE", "Cone", "Solid, along the empty's Y axis"),
    ("NODE", "Node", "Written as JSON"),
    ("NONE", "None", "No part of the model"),
]


def _changed(self, context):
    if context.scene and context.scene.blobfield.live:
        live.touch()


class SceneSettings(bpy.types.PropertyGroup):
    url: StringProperty(
        name="Server", default=blobfield.DEFAULT_URL, update=_changed,
        description="Address of blobfieldd")
    source: EnumProperty(
        name="Model", update=_changed, default="OBJECTS", items=[
            ("OBJECTS", "Objects", "Empties, curves and cubes of a "
             "collection"),
            ("TEXT", "Text", "A document in a text block"),
            ("FILE", "File", "A document in a file")])
    collection: PointerProperty(
        name="Collection", type=bpy.types.Collection, update=_changed,
        description="The scene's own if none is given; collections in it are "
        "compositions of their own")
    operator: EnumProperty(name="Operator", items=OPERATORS, update=_changed,
                           default="camel", description="How parts blend")
    text: PointerProperty(name="Text", type=bpy.types.Text, update=_changed)
    path: StringProperty(name="File", subtype="FILE_PATH", update=_changed)
    resolution: IntProperty(
        name="Resolution", default=48, min=2, max=1024, soft_max=256,
        update=_changed, description="Cells along the longest side")
    iso: FloatProperty(
        name="Iso", default=0.5, min=1e-3, max=1e3, soft_max=1, precision=3,
        update=_changed, description="The value whose level set is shown")
    features: BoolProperty(
        name="Sharp Edges", default=True, update=_changed,
        description="Place vertices on sharp edges and corners")
    smooth: BoolProperty(
        name="Smooth Normals", default=True, update=_changed,
        description="The field's own normals")
    colors: BoolProperty(
        name="Colours", default=True, update=_changed,
        description="Vertex colours, from materials or the objects' colour")
    live: BoolProperty(
        name="Live", default=False, update=_changed,
        description="Remesh whenever something changes")
    target: PointerProperty(
        name="Target", type=bpy.types.Object,
        poll=lambda self, ob: ob.type == "MESH",
        description="The object that shows the surface; made if missing")


class ObjectSettings(bpy.types.PropertyGroup):
    kind: EnumProperty(name="Part", items=KINDS, update=_changed)
    cut: BoolProperty(name="Cut", update=_changed,
                      description="Take this away from the rest")
    radius: FloatProperty(
        name="Radius", default=0.25, min=1e-3, soft_max=2, unit="LENGTH",
        update=_changed, description="Of rings, and of curves without bevel")
    falloff: FloatProperty(
        name="Falloff", default=0.5, min=1e-3, soft_max=5, unit="LENGTH",
        update=_changed,
        description="How far a solid's field reaches from its surface")
    node: StringProperty(
        name="Node", update=_changed, description="JSON, such as "
        '{"type": "disc", "center": [0,0,0], "normal": [0,0,1], '
        '"disc_radius": 1, "radius": 0.2}')


class CollectionSettings(bpy.types.PropertyGroup):
    operator: EnumProperty(
        name="Operator", update=_changed,
        items=[("INHERIT", "As Above", "That of the collection it is in")]
        + OPERATORS)
    cut: BoolProperty(name="Cut", update=_changed,
                      description="Take this away from the rest")


class BLOBFIELD_OT_check(bpy.types.Operator):
    """Ask the server who it is"""
    bl_idname = "blobfield.check"
    bl_label = "Check Connection"

    def execute(self, context):
        try:
            url = context.scene.blobfield.url
            with blobfield.Client(url, timeout=5, connect_timeout=2,
                                  retry_for=0,
                                  token=preferences.token(url)) as client:
                info = client.info()
        except (blobfield.BlobfieldError, ValueError) as e:
            live.state.say(str(e), failed=True)
            self.report({"WARNING"}, str(e))
            return {"CANCELLED"}
        device = (info["device"] or {}).get("name", "no device yet")
        live.state.say(f"{info['name']} {info['version']} on {device}")
        return {"FINISHED"}


class BLOBFIELD_OT_remesh(bpy.types.Operator):
    """Mesh the surface anew"""
    bl_idname = "blobfield.remesh"
    bl_label = "Remesh"
    bl_options = {"REGISTER", "UNDO"}

    wait: BoolProperty(name="Wait", options={"SKIP_SAVE"},
                       description="Until it is there: for scripts")

    def execute(self, context):
        if not live.begin(context.scene):
            self.report({"WARNING"}, live.state.message)
            return {"CANCELLED"}
        if self.wait and not (live.wait() and not live.state.failed):
            self.report({"WARNING"}, live.state.message)
            return {"CANCELLED"}
        return {"FINISHED"}


class BLOBFIELD_OT_cancel(bpy.types.Operator):
    """Give up what runs"""
    bl_idname = "blobfield.cancel"
    bl_label = "Cancel"

    def execute(self, context):
        live.stop()
        live.state.say("cancelled")
        return {"FINISHED"}


class BLOBFIELD_OT_to_text(bpy.types.Operator):
    """Write the collection's document to a text block"""
    bl_idname = "blobfield.to_text"
    bl_label = "Document to Text"

    def execute(self, context):
        s = context.scene.blobfield
        try:
            made = tree.from_collection(
                s.collection or context.scene.collection, s.operator, s.target)
        except tree.TreeError as e:
            self.report({"WARNING"}, str(e))
            return {"CANCELLED"}
        text = bpy.data.texts.new("blobfield.json")
        text.write(tree.json.dumps(made.document, indent=1))
        s.text = text
        return {"FINISHED"}


class BLOBFIELD_PT_panel(bpy.types.Panel):
    bl_idname = "BLOBFIELD_PT_panel"
    bl_label = "Blobfield"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Blobfield"

    def draw(self, context):
        layout = self.layout
        s = context.scene.blobfield
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.prop(s, "url")
        layout.operator("blobfield.check")
        row = layout.row()
        row.use_property_split = False
        row.prop(s, "source", expand=True)
        if s.source == "OBJECTS":
            layout.prop(s, "collection")
            layout.prop(s, "operator")
        elif s.source == "TEXT":
            layout.template_ID(s, "text", new="text.new", open="text.open")
        else:
            layout.prop(s, "path")
        column = layout.column(align=True)
        column.prop(s, "resolution")
        column.prop(s, "iso")
        column = layout.column(heading="Keep")
        column.prop(s, "features")
        column.prop(s, "smooth")
        column.prop(s, "colors")
        layout.prop(s, "target")
        row = layout.row(align=True)
        row.use_property_split = False
        if live.state.job is None:
            row.operator("blobfield.remesh")
        else:
            row.operator("blobfield.cancel")
        row.prop(s, "live", toggle=True)
        # Letters are some 7 pixels wide; margins and the icon take 60.
        scale = context.preferences.system.ui_scale
        _draw_state(layout, int((context.region.width / scale - 60) / 7))


def _draw_state(layout, width):
    state = live.state
    if not state.message:
        return
    column = layout.box().column(align=True)
    column.alert = state.failed
    lines = _wrapped([state.message] + state.faults, max(width, 12))
    for i, line in enumerate(lines):
        column.label(text=line, icon="BLANK1" if i else
                     "ERROR" if state.failed else "INFO")


def _wrapped(lines, width):
    """Labels do not wrap by themselves."""
    for line in lines:
        while len(line) > width:
            at = line.rfind(" ", 0, width)
            at = at if at > 0 else width
            yield line[:at]
            line = "  " + line[at:].strip()
        yield line


class BLOBFIELD_PT_part(bpy.types.Panel):
    bl_idname = "BLOBFIELD_PT_part"
    bl_label = "Part"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Blobfield"

    @classmethod
    def poll(cls, context):
        return (context.object is not None
                and context.scene.blobfield.source == "OBJECTS")

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        own = context.object.blobfield
        layout.label(text=context.object.name)
        layout.prop(own, "kind")
        if own.kind == "NODE":
            layout.prop(own, "node")
        layout.prop(own, "cut")
        layout.prop(own, "radius")
        layout.prop(own, "falloff")
        collection = context.object.users_collection
        if collection and collection[0] != context.scene.collection:
            layout.separator()
            layout.label(text=collection[0].name)
            layout.prop(collection[0].blobfield, "operator")
            layout.prop(collection[0].blobfield, "cut")


CLASSES = (SceneSettings, ObjectSettings, CollectionSettings,
           BLOBFIELD_OT_check, BLOBFIELD_OT_remesh, BLOBFIELD_OT_cancel,
           BLOBFIELD_OT_to_text, BLOBFIELD_PT_panel, BLOBFIELD_PT_part)


def register():
    for c in CLASSES:
        bpy.utils.register_class(c)
    bpy.types.Scene.blobfield = PointerProperty(type=SceneSettings)
    bpy.types.Object.blobfield = PointerProperty(type=ObjectSettings)
    bpy.types.Collection.blobfield = PointerProperty(type=CollectionSettings)


def unregister():
    for kind in (bpy.types.Scene, bpy.types.Object, bpy.types.Collection):
        del kind.blobfield
    for c in reversed(CLASSES):
        bpy.utils.unregister_class(c)
