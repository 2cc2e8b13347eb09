"""The keys of a `rig.yaml`, each declared once: its type, its bounds, and its meaning, which is written beside it.

docs/rig_file.md shows such a file. A key that is left out has the default of the part of the rig that it belongs to; a
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


class Metres(float):
    """Bound of a length's absolute value, above which it is in another unit."""


class Kilograms(float):
    """Bound of a mass, above which it is in another unit."""


class Key(NamedTuple):
    """One key of a form, as it was declared."""

    name: str
    """The name of the form's field."""
    text: str
    """The key in the file."""
    kind: object
    """The first type of its value that is not None, without annotations."""
    comment: str
    """What it means."""
    declared: object
    """Its whole type, with its bounds."""
    required: bool
    metres: float = 0.0
    kilograms: float = 0.0


@cache
def keys(form: type["Form"]) -> tuple[Key, ...]:
    """Returns the keys of a form in the order in which they are written."""
    declared = []
    for item in msgspec.structs.fields(form):
        metas = {type(meta): meta for meta in getattr(item.type, "__metadata__", ())}
        declared.append(
            Key(
                name=item.name,
                text=item.encode_name,
                kind=next(kind for kind in alternatives(item.type) if kind is not NoneType),
                comment=metas.get(str, ""),
                declared=item.type,
                required=item.required,
                metres=metas.get(Metres, 0.0),
                kilograms=metas.get(Kilograms, 0.0),
            )
        )
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
    """Pose in the world or the palm."""

    position: Annotated[Vector, "of its origin", Metres(100)] = (0.0, 0.0, 0.0)
    quaternion_xyzw: Annotated[tuple[float, float, float, float], "its rotation, of any length"] = (
        0.0,
        0.0,
        0.0,
        1.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.matrix()

    def matrix(self) -> Array:
        """Returns the transform (4, 4); raises InvalidInput where the quaternion is zero."""
        return se3.from_position_quaternion(self.position, self.quaternion_xyzw)


class LinkPoseForm(PoseForm):
    """Pose on a link of the hand."""

    position: Annotated[Vector, "of its origin in the link", Metres(0.5)] = (0.0, 0.0, 0.0)


class HandForm(Section):
    """The hand's file, and how well its joints are known."""

    file: Annotated[Text, "URDF or MJCF, by a path from the rig on or as package://"]
    palm: Annotated[Text, "the link that poses are given in"]
    sigma_joint_offset: Annotated[Angle | None, "constant error of each joint angle"] = field(
        name="joint_offset_deg", default=None
    )
    sigma_joint: Annotated[Angle | None, "from reading to reading"] = field(
        name="joint_noise_deg", default=None
    )
    sigma_coupled: Annotated[Angle | None, "of joints that follow others, not measured"] = field(
        name="coupled_joint_deg", default=None
    )
    joint_names: Annotated[
        dict[str, Text] | None, "{prefix: of messages}, {without: that they lack}, or theirs: the file's"
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

    ellipsoid: Annotated[Vector | None, "semi-axes [m]"] = None
    sphere: Annotated[float | None, "radius [m]"] = None
    min_force: Annotated[Positive, "less is no contact [N]"] = MIN_FORCE
    cap: Annotated[float | None, "least z of the surface that is sensed [m]"] = None
    max_friction: Annotated[Positive | None, "a load of more friction is no contact's"] = None

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
    """Errors of a force/torque sensor."""

    sigma_force: Annotated[Load | None, "of a reading [N]"] = field(name="force", default=None)
    sigma_torque: Annotated[Load | None, "of a reading [N m]"] = field(name="torque", default=None)
    sigma_gain: Annotated[Annotated[float, Meta(ge=0, le=1)] | None, "relative, constant, of each axis"] = (
        field(name="gain", default=None)
    )


class BiasForm(Form):
    """What a force/torque sensor reads without load and without its tip's weight."""

    force: Annotated[Vector, "[N]"] = (0.0, 0.0, 0.0)
    torque: Annotated[Vector, "[N m]"] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        checks.load(self.force, "force", (3,))
        checks.load(self.torque, "torque", (3,))


class SensorForm(Section, kw_only=True):
    """Six-axis force/torque sensor behind a fingertip."""

    pose: Annotated[LinkPoseForm | None, "where it measures, and along which axes, in the frame"] = None
    reading: Annotated[
        Literal["on_sensor", "on_tip"],
        "a tip at rest reads its weight along gravity: on_sensor; against it: on_tip",
    ]
    noise: Annotated[SensorNoiseForm | None, "of its readings"] = None
    bias: Annotated[BiasForm | None, "its reading without load"] = None
    tip_mass: Annotated[AtLeastZero, "of all that hangs on it: handsight calibrate sensors", Kilograms(2)] = (
        0.0
    )
    tip_center: Annotated[Vector, "of mass, from the sensor", Metres(0.5)] = (0.0, 0.0, 0.0)
    full_scale: Annotated[tuple[Load, Load] | None, "force [N] and torque [N m] that are no measurement"] = (
        None
    )


class FingerForm(Section, kw_only=True):
    """One finger; its name is yours, and topics use it."""

    frame: Annotated[Text, "the body the tip moves with"]
    surface: Annotated[LinkPoseForm | None, "the shape's centre in it; the tip points along +z"] = None
    tip: Annotated[TipForm, "its shape, and what is a contact of it"]
    sigma_point: Annotated[
        AtLeastZero | None,
        "calibration, softness: what joints and sensor do not explain",
        Metres(LARGEST),
    ] = None
    sigma_normal: Annotated[Angle | None, "the same of a contact's normal"] = field(
        name="sigma_normal_deg", default=None
    )
    friction: Annotated[Friction | None, "with objects; without it, it is learnt"] = None
    sigma_friction: Annotated[Friction | None, "of that friction"] = None
    sensor: Annotated[SensorForm | None, "without it, taxels or messages say where the tip touches"] = None

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

    frame: Annotated[Text | None, "the link that it is on; of a URDF's sensor, that of the file"] = None
    pose: Annotated[
        LinkPoseForm | None, "in the frame: x along its rows, y along its columns, z out of the skin"
    ] = None
    topic: Annotated[Text | None, "of its readings, in place of topics.skin"] = None
    message_field: Annotated[Text | None, "path to its readings in a message, as sensors[0].forces"] = field(
        name="field", default=None
    )
    rows: Annotated[int | None, "of a grid"] = None
    columns: Annotated[int | None, "of a grid"] = None
    pitch: Annotated[float | None, "from taxel to taxel of a grid [m]"] = None
    radius: Annotated[Positive | None, "of a grid that is bent about its y", Metres(0.5)] = None
    taxels: Annotated[list[list[float]] | None, "x, y, z of each, then its normal, then its own x"] = None
    file: Annotated[Text | None, "a table of the same as CSV, JSON or YAML, beside the rig"] = None
    unit: Annotated[Literal["m", "mm"] | None, "of the places in taxels or file"] = None
    urdf: Annotated[Text | None, "a tactile sensor of the hand's URDF"] = None
    layout: Annotated[Text | None, "a product, as xela:fingertip"] = None
    components: Annotated[Literal[1, 3] | None, "1: along the normal; 3: x, y and into the skin [N]"] = None
    indentation: Annotated[bool | None, "true: readings are how deep it is pressed in [m]"] = None
    threshold: Annotated[Positive, "rise of a touched taxel, in the unit of its readings"]
    full_scale: Annotated[Positive | None, "a taxel there before the first touch is broken"] = None
    scale: Annotated[float | list[float] | None, "a reading is scale (message - offset)"] = None
    offset: Annotated[float | list[float] | None, "in the unit of the message, of each component"] = None
    area: Annotated[Positive | None, "of a taxel [m^2]"] = None
    noise: Annotated[Annotated[float, Meta(gt=0, le=1)] | None, "of a reading, relative to it"] = None
    sigma_point: Annotated[Positive | None, "of each taxel's height by itself", Metres(LARGEST)] = None
    sigma_normal: Annotated[Annotated[float, Meta(gt=0, le=180)] | None, "of a taxel's normal"] = field(
        name="sigma_normal_deg", default=None
    )
    sigma_mount: Annotated[Positive | None, "of the height of all of it", Metres(LARGEST)] = None
    stiffness: Annotated[Positive | None, "of the skin, pressure by depth [N/m^3]"] = None
    sigma_stiffness: Annotated[Positive | None, "without it, half of the stiffness"] = None

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
    """Errors of vision's poses of the object."""

    sigma_position: Annotated[AtLeastZero | None, "of its position", Metres(5)] = field(
        name="position", default=None
    )
    sigma_rotation: Annotated[Angle | None, "of its rotation"] = field(name="rotation_deg", default=None)


class ImageNoiseForm(VisionNoiseForm):
    """Noise of vision's poses; a message's own covariance replaces it."""

    sigma_ray: Annotated[AtLeastZero | None, "position along the ray from the camera", Metres(5)] = field(
        name="along_ray", default=None
    )


CAMERA_ERRORS = {"noise": "", "constant_error": "_constant", "correlated_error": "_correlated"}
"""Keys of a camera's errors, and the ends of the names of their sigmas in the rig."""


class IntrinsicsForm(Form):
    """Camera matrix and the size of the images [pixels]."""

    width: Annotated[Pixels, "of an image"]
    height: Annotated[Pixels, "of an image"]
    fx: Annotated[Pixels, "focal length along x"]
    fy: Annotated[Pixels, "focal length along y"]
    cx: Annotated[Pixels, "x of the optical axis"]
    cy: Annotated[Pixels, "y of the optical axis"]


class CameraForm(Section):
    """The camera that sees the object; without it poses must come in the world's or the palm's frame."""

    fixed_to: Annotated[Literal["world", "palm"], "world or palm, which it stands on"] = "world"
    pose: Annotated[PoseForm | None, "of its optical frame (x right, y down, z forward)"] = None
    noise: Annotated[ImageNoiseForm | None, "of a detected pose, independent in each image"] = None
    constant_error: Annotated[VisionNoiseForm | None, "of its calibration"] = None
    correlated_error: Annotated[VisionNoiseForm | None, "that images of nearly the same time share"] = None
    correlation_time: Annotated[Positive | None, "for which it lasts [s]"] = None
    latency: Annotated[AtLeastZero | None, "by which a pose is older than its stamp [s]"] = None
    sigma_latency: Annotated[AtLeastZero | None, "of the latency, which is estimated [s]"] = None
    depth_camera: Annotated[DepthCamera | None, "how it measures depth, which determines its errors"] = None
    intrinsics: Annotated[IntrinsicsForm | None, "of its images, where no CameraInfo says them"] = None
    lens: Annotated[list[float] | None, "k1, k2, p1, p2[, k3[, k4, k5, k6]]; without it, rectified"] = None

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
    """The table on which objects stand until they are lifted."""

    height: Annotated[float, "of its top in the world", Metres(100)]
    sigma_height: Annotated[Positive | None, "of its height", Metres(5)] = None
    sigma_tilt: Annotated[Angle | None, "of its tilt about each side"] = field(
        name="sigma_tilt_deg", default=None
    )


class WorldForm(Section):
    """The world, whose z is up, and how the palm's pose in it is known."""

    palm_from: Annotated[Literal["tf", "joints", "nowhere"], "joints: the hand's file has the arm in it"] = (
        "tf"
    )
    gravity: Annotated[Vector, "in the world [m/s^2]"] = GRAVITY

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.gravity))
        least, most = GRAVITY_RANGE
        if not least <= length <= most:
            raise ValueError(f"gravity: expected a vector of {least} to {most} m/s², got length {length:.3g}")


class FramesForm(Section):
    """Names of the frames in messages."""

    world: Annotated[Text, "the world's"] = "world"
    palm: Annotated[Text, "that of hand.palm"] = "palm"
    camera: Annotated[Text, "the camera's optical frame"] = "camera"


class JointStatesForm(Form):
    """Topic of the joint states of a driver that publishes them otherwise than as a JointState in radians."""

    topic: Annotated[Text, "of the joint states"] = "/joint_states"
    message_field: Annotated[Text | None, "path to the positions in a message, as data[0:6]"] = field(
        name="field", default=None
    )
    names: Annotated[list[Text | None] | None, "of the joints, in that order; null for a number of none"] = (
        None
    )
    scale: Annotated[float | list[float] | None, "a position is scale (message - offset) [rad]"] = None
    offset: Annotated[float | list[float] | None, "in the unit of the message"] = None

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
    """Topics; one that has no usual name is not read where it is left out."""

    joint_states: Annotated[
        Text | JointStatesForm | None,
        "JointState; or {topic, field, names, scale, offset} of another driver",
    ] = None
    vision: Annotated[Text | None, "PoseStamped or PoseWithCovarianceStamped; else /vision/object"] = None
    tf: Annotated[Text | None, "beside it, /tf_static; else /tf"] = None
    color: Annotated[Text | None, "Image or CompressedImage"] = None
    depth: Annotated[Text | None, "Image of depths"] = None
    camera_info: Annotated[Text | None, "CameraInfo"] = None
    detections: Annotated[Text | None, "Detection2DArray"] = None
    mask: Annotated[Text | None, "Image that is not 0, or the object's label, where it is"] = None
    truth: Annotated[Text | None, "PoseStamped in the palm (frames.palm), only ever compared with"] = None
    messages: Annotated[
        list[Text] | None, "folders PACKAGE/msg of .msg files, of types that come without a definition"
    ] = None
    offsets: Annotated[dict[str, float] | None, "by topic, added to its stamps [s], of another clock"] = None
    wrenches: Annotated[dict[str, Text] | None, "WrenchStamped, by finger; else /NAME/wrench"] = None
    contacts: Annotated[dict[str, Text] | None, "of tips that sense contacts themselves, by finger"] = None
    skin: Annotated[dict[str, Text] | None, "by surface; else /NAME/taxels"] = None


class CylinderForm(Form):
    """Cylinder about its z, from its middle."""

    radius: Annotated[Positive, "of its circle", Metres(5)]
    height: Annotated[Positive, "along z", Metres(5)]


class ShapeForm(Form):
    """Shape of an object: its sides, a cylinder, a mesh (a path from the form's file on), or that of a name in the
    object library."""

    box: Annotated[tuple[Positive, Positive, Positive] | None, "its sides", Metres(5)] = None
    cylinder: Annotated[CylinderForm | None, "its radius and height"] = None
    mesh: Annotated[Text | None, "a mesh or a cloud, by a path from this file on"] = None
    scale: Annotated[Positive | None, "of the mesh, metres a unit"] = None
    name: Annotated[Text | None, "in the object library"] = None

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

    symmetries: Annotated[Literal["find"] | None, "find: those of the mesh are searched"] = None
    mass: Annotated[Positive | None, "of the object", Kilograms(100)] = None
    sigma_mass: Annotated[Positive | None, "without it, 3 % of the mass", Kilograms(100)] = None
    center_of_mass: Annotated[
        Vector | Literal["homogeneous"] | None, "in the object; homogeneous: its volume's", Metres(5)
    ] = None
    sigma_center_of_mass: Annotated[Positive | None, "along each axis", Metres(5)] = None
    friction: Annotated[Friction | None, "with the fingertips; without it, it is learnt"] = None
    sigma_friction: Annotated[Friction | None, "of that friction"] = None
    label: Annotated[Text | None, "what a detector calls it; without it, the object's name"] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("mass", "center_of_mass", "friction"):
            if getattr(self, f"sigma_{name}") is not None and getattr(self, name) is None:
                raise ValueError(f"sigma_{name}: expected beside {name} only, got it alone")


class RigForm(Section):
    """All that is known of a robot."""

    version: Annotated[float, "of this format"]
    hand: Annotated[HandForm, "its file, and its joints"]
    fingers: Annotated[dict[str, FingerForm], "by names of yours, that topics use"]
    skin: Annotated[dict[str, SkinForm] | None, "tactile surfaces on any link, by names of yours"] = None
    camera: Annotated[CameraForm | None, "that sees the object"] = None
    table: Annotated[TableForm | None, "objects stand on it until they are lifted"] = None
    world: Annotated[WorldForm | None, "and the palm's pose in it"] = None
    frames: Annotated[FramesForm | None, "what messages call them in frame_id"] = None
    topics: Annotated[TopicsForm | None, "what is read, and where"] = None
    objects: Annotated[dict[str, ObjectForm] | None, "shapes that may be in the hand, by name"] = None

    def __post_init__(self) -> None:
        if not self.fingers:
            raise ValueError("fingers: expected at least one finger, got none")
