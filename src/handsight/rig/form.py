"""The keys of a `rig.yaml`, each declared once: its type, its bounds, and the comment that is written beside it.

docs/robots.md shows such a file. A key that is left out has the default of the part of the rig that it belongs to; a
field has the name of that part's attribute. Lengths are in metres, angles in degrees, forces in newtons. Every sigma is
one standard deviation per axis.
"""

from collections.abc import Collection
from functools import cache
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta, field

from handsight import checks, se3
from handsight.camera import check_lens
from handsight.checks import Array
from handsight.contact import Ellipsoid, Fingertip, Sphere, WrenchCalibration
from handsight.contact.calibration import GRAVITY_RANGE
from handsight.contact.fingertips import LARGEST, MIN_FORCE
from handsight.contact.taxels import TactileSurface
from handsight.errors import HandsightError, InvalidInput
from handsight.hand import Hand
from handsight.msgspec_errors import alternatives
from handsight.objects import ObjectSpec
from handsight.rig import layouts
from handsight.rig.rig import GRAVITY, DepthCamera, Finger, JointReading, MountedCamera, message_steps
from handsight.rig.taxel_table import UNITS

VERSION = 1
Values = dict[str, Any]


def key(comment: str = "", *, metres: float = 0.0, kilograms: float = 0.0) -> Meta:
    """Returns the annotation of a key: its comment, and bounds above which a length or a mass has the wrong unit."""
    return Meta(description=comment or None, extra={"metres": metres, "kilograms": kilograms})


class Key(NamedTuple):
    """One key of a form, as it was declared."""

    name: str
    """The name of the form's field."""
    text: str
    """The key in the file."""
    kind: object
    """The first type of its value that is not None, without annotations."""
    comment: str
    metres: float = 0.0
    kilograms: float = 0.0


@cache
def keys(form: type["Form"]) -> tuple[Key, ...]:
    """Returns the keys of a form in the order in which they are written."""
    declared = []
    for item in msgspec.structs.fields(form):
        metas = getattr(item.type, "__metadata__", ())
        extra = {name: value for meta in metas for name, value in (meta.extra or {}).items()}
        comment = next((meta.description for meta in metas if meta.description), "")
        kind = next(kind for kind in alternatives(item.type) if kind is not NoneType)
        declared.append(Key(item.name, item.encode_name, kind, comment, **extra))
    return tuple(declared)


class Form(msgspec.Struct, forbid_unknown_fields=True):
    """One mapping of the file, which is written in one line."""

    def __post_init__(self) -> None:
        for each in keys(type(self)):
            value = getattr(self, each.name)
            if value is None or isinstance(value, str):
                continue
            if each.metres and np.abs(value).max() > each.metres:
                came = checks.metres_text(value, each.metres)
                raise ValueError(f"{each.text}: expected metres within {each.metres:g}, got {came}")
            if each.kilograms and value > each.kilograms:
                raise ValueError(f"{each.text}: expected kilograms, got {value:g} (grams?)")

    def given(self) -> Values:
        """Returns the values that the file has, by the names of the rig's attributes; angles in radians."""
        values = Values()
        for each in keys(type(self)):
            if (value := getattr(self, each.name)) is not None:
                values[each.name] = float(np.deg2rad(value)) if each.text.endswith("_deg") else value
        return values

    def sigmas(self) -> Values:
        """Returns the standard deviations among `given`."""
        return {name: value for name, value in self.given().items() if name.startswith("sigma")}


class Section(Form):
    """Form of which each key has a line of its own."""


Positive = Annotated[float, Meta(gt=0)]
AtLeastZero = Annotated[float, Meta(ge=0)]
Angle = Annotated[float, Meta(ge=0, le=180)]
Pixels = Annotated[float, Meta(gt=0, le=1e5)]
Friction = Annotated[float, Meta(ge=0.01, le=10)]
Load = Annotated[float, Meta(gt=0, le=checks.MAX_LOAD)]
Text = Annotated[str, Meta(pattern=r"\S")]
Vector = tuple[float, float, float]


class PoseForm(Form):
    position: Annotated[Vector, key(metres=100)] = (0.0, 0.0, 0.0)
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.matrix()

    def matrix(self) -> Array:
        """Returns the transform (4, 4); raises InvalidInput where the quaternion is zero."""
        return se3.from_position_quaternion(self.position, self.quaternion_xyzw)


class LinkPoseForm(PoseForm):
    """Pose on a link of a finger."""

    position: Annotated[Vector, key(metres=0.5)] = (0.0, 0.0, 0.0)


class HandForm(Section):
    file: Annotated[Text, key("URDF or MJCF")]
    palm: Text
    sigma_joint_offset: Annotated[Angle | None, key("constant error of each joint angle")] = field(
        name="joint_offset_deg", default=None
    )
    sigma_joint: Angle | None = field(name="joint_noise_deg", default=None)
    sigma_coupled: Annotated[Angle | None, key("of joints that follow others, not measured")] = field(
        name="coupled_joint_deg", default=None
    )
    joint_names: Annotated[
        dict[str, Text] | None, key("{prefix: of messages}, {without: that they lack}, or theirs: the file's")
    ] = field(name="joints", default=None)

    def names(self, joints: Collection[str]) -> dict[str, str]:
        """Returns by the name of a joint in messages that in the hand's file, which has these joints; raises
        ValueError."""
        given = dict(self.joint_names or {})
        prefix, without = given.pop("prefix", ""), given.pop("without", "")
        lacking = {name: name.removeprefix(without) for name in joints}
        names = {prefix + lacking[name]: name for name in joints}
        for name, known in given.items():
            if known not in joints:
                raise ValueError(
                    f"{name}: expected a joint of the hand's file, got {known!r}{checks.suggestion(known, joints)}"
                )
        return {name: known for name, known in (names | given).items() if name != known}


class TipForm(Form):
    """Shape of a tip: the semi-axes of an ellipsoid, or the radius of a sphere."""

    ellipsoid: Vector | None = None
    sphere: float | None = None
    min_force: Positive = MIN_FORCE
    cap: float | None = None
    max_friction: Positive | None = None

    def __post_init__(self) -> None:
        if (self.ellipsoid is None) == (self.sphere is None):
            came = "neither" if self.sphere is None else "both"
            raise ValueError(f"expected ellipsoid: [a, b, c] or sphere: r, got {came}")
        try:
            self.shape(np.eye(4))
        except HandsightError as error:
            raise ValueError(f"{'ellipsoid' if self.ellipsoid else 'sphere'}: {error}") from None

    def shape(self, T_surface_sensor: Array) -> Fingertip:
        """Returns the tip; raises a HandsightError for a size that no tip has."""
        options = {name: getattr(self, name) for name in ("cap", "max_friction", "min_force")}
        if self.ellipsoid is not None:
            return Ellipsoid(self.ellipsoid, T_surface_sensor=T_surface_sensor, **options)
        return Sphere(self.sphere or 0.0, T_surface_sensor=T_surface_sensor, **options)


class SensorNoiseForm(Form):
    sigma_force: Load | None = field(name="force", default=None)
    sigma_torque: Load | None = field(name="torque", default=None)
    sigma_gain: Annotated[float, Meta(ge=0, le=1)] | None = field(name="gain", default=None)


class BiasForm(Form):
    force: Vector = (0.0, 0.0, 0.0)
    torque: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        checks.load(self.force, "force", (3,))
        checks.load(self.torque, "torque", (3,))


class SensorForm(Section, kw_only=True):
    pose: Annotated[LinkPoseForm | None, key("in the frame")] = None
    reading: Annotated[
        Literal["on_sensor", "on_tip"],
        key("a tip at rest reads its weight along gravity: on_sensor; against it: on_tip"),
    ]
    noise: SensorNoiseForm | None = None
    bias: BiasForm | None = None
    tip_mass: Annotated[
        AtLeastZero, key("kg; handsight.calibrate_wrench finds bias, mass and centre", kilograms=2)
    ] = 0.0
    tip_center: Annotated[Vector, key("of mass, from the sensor", metres=0.5)] = (0.0, 0.0, 0.0)
    full_scale: Annotated[tuple[Load, Load] | None, key("force, torque")] = None


class FingerForm(Section, kw_only=True):
    frame: Annotated[Text, key("the body the tip moves with")]
    surface: Annotated[LinkPoseForm | None, key("the shape's centre in it; the tip points along +z")] = None
    tip: TipForm
    sigma_point: Annotated[
        AtLeastZero | None,
        key("calibration, softness: what joints and sensor do not explain", metres=LARGEST),
    ] = None
    sigma_normal: Angle | None = field(name="sigma_normal_deg", default=None)
    friction: Annotated[Friction | None, key("with objects; without it, it is learnt")] = None
    sigma_friction: Friction | None = None
    sensor: Annotated[SensorForm | None, key("without it, taxels or messages say where the tip touches")] = (
        None
    )

    def finger(self) -> Finger:
        """Returns the part of the rig."""
        sensor = self.sensor or SensorForm(reading="on_tip")
        T_frame_surface = (self.surface or LinkPoseForm()).matrix()
        T_surface_sensor = (sensor.pose or LinkPoseForm()).matrix()
        bias = sensor.bias or BiasForm()
        biases = (np.array(bias.force), np.array(bias.torque))
        center = np.array(sensor.tip_center)
        calibration = WrenchCalibration(*biases, sensor.tip_mass, center, reading=sensor.reading)
        return Finger(
            frame=self.frame,
            T_frame_surface=T_frame_surface,
            tip=self.tip.shape(se3.inverse(T_frame_surface) @ T_surface_sensor),
            calibration=calibration,
            full_scale=sensor.full_scale,
            friction=self.friction,
            **(sensor.noise or SensorNoiseForm()).sigmas(),
            **self.sigmas(),
        )


class SkinForm(Form, kw_only=True):
    """Tactile surface, whose places are those of a grid, a table, a file, a URDF or a product."""

    frame: Text | None = None
    pose: LinkPoseForm | None = None
    topic: Text | None = None
    message_field: Annotated[Text | None, key("path to its readings in a message, as sensors[0].forces")] = (
        field(name="field", default=None)
    )
    rows: int | None = None
    columns: int | None = None
    pitch: float | None = None
    radius: Annotated[Positive | None, key(metres=0.5)] = None
    taxels: list[list[float]] | None = None
    file: Text | None = None
    unit: Literal["m", "mm"] | None = None
    urdf: Text | None = None
    layout: Text | None = None
    components: Literal[1, 3] | None = None
    indentation: Annotated[bool | None, key("true: readings are how deep it is pressed in [m]")] = None
    threshold: Positive
    full_scale: Positive | None = None
    scale: float | list[float] | None = None
    offset: float | list[float] | None = None
    area: Positive | None = None
    noise: Annotated[float, Meta(gt=0, le=1)] | None = None
    sigma_point: Annotated[Positive | None, key(metres=LARGEST)] = None
    sigma_normal: Annotated[float, Meta(gt=0, le=180)] | None = field(name="sigma_normal_deg", default=None)
    sigma_mount: Annotated[Positive | None, key(metres=LARGEST)] = None
    stiffness: Annotated[Positive | None, key("of the skin, pressure by depth [N/m^3]")] = None
    sigma_stiffness: Annotated[Positive | None, key("without it, half of the stiffness")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            message_steps(self.message_field or "data")
        except InvalidInput as error:
            raise ValueError(f"field: {error}") from None
        places = "rows", "taxels", "file", "urdf", "layout"
        kinds = [name for name in places if getattr(self, name) is not None]
        if len(kinds) != 1:
            raise ValueError(
                "expected one of rows (with columns, pitch), taxels, file, urdf, layout, got "
                f"{' and '.join(kinds) or 'none'}"
            )
        if self.frame is None and self.urdf is None:
            raise ValueError("frame: expected the link that the taxels are on, got none")
        if self.sigma_stiffness is not None and self.stiffness is None:
            raise ValueError("sigma_stiffness: expected beside stiffness, got no stiffness")
        if self.rows is not None:
            self.surface(Path(), None)

    def surface(self, folder: Path, hand: Hand | None) -> TactileSurface:
        """Returns the part of the rig; raises InvalidInput. A file's path begins at the folder."""
        given = self.given()
        places = {name: given.pop(name, None) for name in PLACES}
        if self.rows is not None:
            found = layouts.Layout.bent(self.rows, places["columns"], given.get("pitch"), self.radius)
        elif self.taxels is not None:
            found = layouts.Layout.of(self.taxels, "taxels", UNITS[self.unit or "m"])
        elif self.file is not None:
            found = layouts.from_file(self.file, folder, self.unit)
        elif self.urdf is not None and hand is not None:
            found = layouts.from_urdf(self.urdf, hand)
        else:
            found = layouts.by_name(self.layout or "", self.pitch, self.radius)
        return found.surface((self.pose or LinkPoseForm()).matrix(), hand, given)


PLACES = (
    *("pose", "topic", "message_field", "rows", "columns", "radius", "taxels", "file"),
    *("unit", "urdf", "layout"),
)
"""Keys of a `SkinForm` that are no fields of a surface."""
GONE = {
    "kind": "for a gel write indentation: true; for a pad that is touched somewhere rows: 1, columns: 1, and as pitch "
    "its diagonal; else leave it out",
    "image": "rows and columns are those of the taxels; an image is averaged over blocks of pixels",
    "channels": "have the driver publish the size of the change, which is one number",
}
"""Keys of a tactile surface that are refused, and what to do instead."""


class VisionNoiseForm(Form):
    sigma_position: Annotated[AtLeastZero | None, key(metres=5)] = field(name="position", default=None)
    sigma_rotation: Angle | None = field(name="rotation_deg", default=None)


class ImageNoiseForm(VisionNoiseForm):
    sigma_ray: Annotated[AtLeastZero | None, key("position along the ray from the camera", metres=5)] = field(
        name="along_ray", default=None
    )


CAMERA_ERRORS = {"noise": "", "constant_error": "_constant", "correlated_error": "_correlated"}
"""Keys of a camera's errors, and the ends of the names of their sigmas in the rig."""


class IntrinsicsForm(Form):
    """Camera matrix and the size of the images [pixels]."""

    width: Pixels
    height: Pixels
    fx: Pixels
    fy: Pixels
    cx: Pixels
    cy: Pixels


class CameraForm(Section):
    fixed_to: Annotated[Literal["world", "palm"], key("world or palm")] = "world"
    pose: Annotated[PoseForm | None, key("of its optical frame (x right, y down, z forward)")] = None
    noise: Annotated[ImageNoiseForm | None, key("of a detected pose, independent in each image")] = None
    constant_error: Annotated[VisionNoiseForm | None, key("of its calibration")] = None
    correlated_error: Annotated[VisionNoiseForm | None, key("that images of nearly the same time share")] = (
        None
    )
    correlation_time: Annotated[Positive | None, key("for which it lasts [s]")] = None
    latency: Annotated[AtLeastZero | None, key("by which a pose is older than its stamp [s]")] = None
    sigma_latency: AtLeastZero | None = None
    depth_camera: Annotated[
        DepthCamera | None, key("structured_light, time_of_flight or stereo: how it measures depth")
    ] = None
    intrinsics: IntrinsicsForm | None = None
    lens: list[float] | None = None

    def __post_init__(self) -> None:
        if self.lens is not None:
            check_lens(self.lens, "lens")
        if self.lens and self.intrinsics is None:
            raise ValueError("lens: expected intrinsics beside it, got none")

    def camera(self) -> MountedCamera:
        """Returns the part of the rig."""
        given = self.given()
        k = self.intrinsics
        pose = given.pop("pose", None) or PoseForm()
        given |= {"on": given.pop("fixed_to"), "T_mount_camera": pose.matrix()}
        if k is not None:
            given["intrinsics"] = np.array([[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1.0]])
            given["size"] = (int(k.width), int(k.height))
        for name, kind in CAMERA_ERRORS.items():
            errors = given.pop(name, None) or VisionNoiseForm()
            given |= {sigma + kind: value for sigma, value in errors.sigmas().items()}
        return MountedCamera(**given)


class TableForm(Section):
    height: Annotated[float, key("of its top in the world", metres=100)]
    sigma_height: Annotated[Positive | None, key(metres=5)] = None
    sigma_tilt: Angle | None = field(name="sigma_tilt_deg", default=None)


class WorldForm(Section):
    palm_from: Annotated[
        Literal["tf", "joints", "nowhere"], key("tf, joints (the hand's file has the arm in it), nowhere")
    ] = "tf"
    gravity: Vector = GRAVITY

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.gravity))
        least, most = GRAVITY_RANGE
        if not least <= length <= most:
            raise ValueError(f"gravity: expected a vector of {least} to {most} m/s², got length {length:.3g}")


class FramesForm(Section):
    world: Text = "world"
    palm: Text = "palm"
    camera: Text = "camera"


class JointStatesForm(Form):
    """Topic of the joint states of a driver that publishes them otherwise than as a JointState in radians."""

    topic: Text = "/joint_states"
    message_field: Text | None = field(name="field", default=None)
    names: list[Text | None] | None = None
    scale: float | list[float] | None = None
    offset: float | list[float] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            self.reading()
        except InvalidInput as error:
            raise ValueError(str(error)) from None

    def reading(self) -> JointReading:
        """Returns the part of the rig; raises InvalidInput."""
        given = self.given()
        given["field"] = given.pop("message_field", "")
        del given["topic"]
        values: Values = {name: tuple(v) if isinstance(v, list) else v for name, v in given.items()}
        return JointReading(**values)


class TopicsForm(Section):
    joint_states: Annotated[
        Text | JointStatesForm | None,
        key("JointState; or {topic, field, names, scale, offset} of another driver"),
    ] = None
    vision: Text | None = None
    tf: Text | None = None
    color: Text | None = None
    depth: Text | None = None
    camera_info: Text | None = None
    detections: Annotated[Text | None, key("Detection2DArray")] = None
    mask: Annotated[Text | None, key("Image that is not 0, or the object's label, where it is")] = None
    truth: Annotated[Text | None, key("PoseStamped in the palm (frames.palm), only ever compared with")] = (
        None
    )
    messages: Annotated[
        list[Text] | None, key("folders PACKAGE/msg of .msg files, of types that come without a definition")
    ] = None
    offsets: Annotated[
        dict[str, float] | None, key("by topic, added to its stamps [s], of another clock")
    ] = None
    wrenches: dict[str, Text] | None = None
    contacts: dict[str, Text] | None = None
    skin: dict[str, Text] | None = None


class CylinderForm(Form):
    radius: Annotated[Positive, key(metres=5)]
    height: Annotated[Positive, key(metres=5)]


class ShapeForm(Form):
    """Shape of an object: its sides, a cylinder, a mesh (a path from the form's file on), or that of a name in the
    object library."""

    box: Annotated[tuple[Positive, Positive, Positive] | None, key(metres=5)] = None
    cylinder: CylinderForm | None = None
    mesh: Text | None = None
    scale: Positive | None = None
    name: Text | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        kinds = ("box", "cylinder", "mesh", "name")
        found = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(found) != 1:
            raise ValueError(f"expected one of {', '.join(kinds)}, got {' and '.join(found) or 'none'}")
        if self.scale is not None and self.mesh is None:
            raise ValueError(f"scale: expected beside mesh only, got it beside {found[0]}")

    def entry(self, folder: Path) -> ObjectSpec:
        """Returns the object as a value; the path of a mesh begins at the folder."""
        given = self.given()
        if self.cylinder is not None:
            given["cylinder"] = (self.cylinder.radius, self.cylinder.height)
        if self.mesh is not None:
            given["mesh"] = folder / self.mesh
        return ObjectSpec(**given)


class ObjectForm(ShapeForm):
    """Object of a rig: its shape, its weight and its friction."""

    symmetries: Literal["find"] | None = None
    mass: Annotated[Positive | None, key(kilograms=100)] = None
    sigma_mass: Annotated[Positive | None, key("kg; without it, 3 % of the mass", kilograms=100)] = None
    center_of_mass: Annotated[Vector | Literal["homogeneous"] | None, key(metres=5)] = None
    sigma_center_of_mass: Annotated[Positive | None, key(metres=5)] = None
    friction: Annotated[Friction | None, key("with the fingertips; without it, it is learnt")] = None
    sigma_friction: Friction | None = None
    label: Annotated[Text | None, key("what a detector calls it; without it, the object's name")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("mass", "center_of_mass", "friction"):
            if getattr(self, f"sigma_{name}") is not None and getattr(self, name) is None:
                raise ValueError(f"sigma_{name}: expected beside {name} only, got it alone")


class RigForm(Section):
    version: float
    hand: HandForm
    fingers: dict[str, FingerForm]
    skin: dict[str, SkinForm] | None = None
    camera: CameraForm | None = None
    table: Annotated[TableForm | None, key("objects stand on it until they are lifted")] = None
    world: WorldForm | None = None
    frames: Annotated[FramesForm | None, key("what messages call them in frame_id")] = None
    topics: TopicsForm | None = None
    objects: dict[str, ObjectForm] | None = None

    def __post_init__(self) -> None:
        if not self.fingers:
            raise ValueError("fingers: expected at least one finger, got none")
