"""What a `rig.yaml` may say, each key with its unit (docs/robots.md has one); what is not said is as the parts have it.

Lengths in metres, angles in degrees, forces in newtons. Every sigma is one standard deviation per axis.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from msgspec import Meta, field

from handsight import checks, se3
from handsight.checks import Array
from handsight.contact import Ellipsoid, Fingertip, Sphere, WrenchCalibration
from handsight.contact.fingertips import LARGEST
from handsight.contact.taxels import TaxelArray
from handsight.errors import HandsightError
from handsight.rig.form_parts import (
    Angle,
    AtLeastZero,
    Form,
    LinkPoseForm,
    Load,
    Pixels,
    PoseForm,
    Positive,
    Text,
    Vector,
)
from handsight.rig.object_form import ObjectForm
from handsight.rig.rig import (
    FARTHEST,
    LARGEST_HELD,
    LONGEST_LINK,
    Camera,
    DepthCamera,
    Finger,
    check_lens,
)

VERSION = 1
HEAVIEST = 2.0
"""Of what hangs on a sensor [kg]; beyond it the unit is wrong."""


class HandForm(Form):
    file: Text
    """URDF or MJCF; a path from the rig file on, or `package://NAME/rest`."""
    palm: Text
    sigma_joint_offset: Angle | None = field(name="joint_offset_deg", default=None)
    sigma_joint: Angle | None = field(name="joint_noise_deg", default=None)


class TipForm(Form):
    ellipsoid: Vector | None = None
    """Semi-axes."""
    sphere: float | None = None
    """Radius."""
    cap: float | None = None
    max_friction: Positive | None = None
    min_force: Positive = 0.1

    def __post_init__(self) -> None:
        said = [shape for shape in ("ellipsoid", "sphere") if getattr(self, shape) is not None]
        if len(said) != 1:
            came = " and ".join(said) or "neither"
            raise ValueError(f"expected ellipsoid: [a, b, c] or sphere: r, got {came}")
        try:
            self.shape(np.eye(4))
        except HandsightError as error:
            raise ValueError(f"{said[0]}: {error}") from None

    def shape(self, T_surface_sensor: Array) -> Fingertip:
        """The tip; raises a HandsightError where there is none of such a size."""
        options = {name: getattr(self, name) for name in ("cap", "max_friction", "min_force")}
        if self.ellipsoid is not None:
            return Ellipsoid(self.ellipsoid, T_surface_sensor=T_surface_sensor, **options)
        return Sphere(self.sphere or 0.0, T_surface_sensor=T_surface_sensor, **options)


class SensorNoiseForm(Form):
    sigma_force: Load | None = field(name="force", default=None)
    sigma_torque: Load | None = field(name="torque", default=None)


class BiasForm(Form):
    force: Vector = (0.0, 0.0, 0.0)
    torque: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("force", "torque"):
            checks.load(getattr(self, name), name, (3,))


class SensorForm(Form):
    LONGEST: ClassVar = {"tip_center": LONGEST_LINK}

    reading: Literal["on_sensor", "on_tip"]
    pose: LinkPoseForm | None = None
    """In the finger's frame."""
    noise: SensorNoiseForm | None = None
    bias: BiasForm | None = None
    tip_mass: AtLeastZero = 0.0
    """[kg]"""
    tip_center: Vector = (0.0, 0.0, 0.0)
    """Of mass, from the sensor."""
    full_scale: tuple[Load, Load] | None = None
    """Force and torque."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tip_mass > HEAVIEST:
            raise ValueError(f"tip_mass: expected kilograms, got {self.tip_mass:g} (grams?)")

    def calibration(self) -> WrenchCalibration:
        """What is known of the sensor and of what hangs on it."""
        bias = self.bias or BiasForm()
        return WrenchCalibration(
            bias_force=np.array(bias.force),
            bias_torque=np.array(bias.torque),
            mass=self.tip_mass,
            center_of_mass=np.array(self.tip_center),
            residual_force=np.zeros(3),
            residual_torque=np.zeros(3),
            condition=1.0,
            reading=self.reading,
        )


class FingerForm(Form):
    LONGEST: ClassVar = {"sigma_point": LARGEST}

    frame: Text
    tip: TipForm
    sensor: SensorForm
    surface: LinkPoseForm | None = None
    """In the frame."""
    sigma_point: AtLeastZero | None = None
    sigma_normal: Angle | None = field(name="sigma_normal_deg", default=None)

    def finger(self) -> Finger:
        """The part of the rig."""
        sensor, T_frame_surface = self.sensor, (self.surface or LinkPoseForm()).matrix()
        T_surface_sensor = se3.inverse(T_frame_surface) @ (sensor.pose or LinkPoseForm()).matrix()
        return Finger(
            frame=self.frame,
            T_frame_surface=T_frame_surface,
            tip=self.tip.shape(T_surface_sensor),
            calibration=sensor.calibration(),
            full_scale=sensor.full_scale,
            **(sensor.noise or SensorNoiseForm()).sigmas(),
            **self.sigmas(),
        )


class SkinForm(Form):
    LONGEST: ClassVar = {"sigma_point": LARGEST, "sigma_mount": LARGEST}

    frame: Text
    rows: int
    columns: int
    pitch: float
    threshold: Positive
    pose: LinkPoseForm | None = None
    """Of the middle of the grid in the frame."""
    full_scale: Positive | None = None
    sigma_point: Positive | None = None
    sigma_normal: Annotated[float, Meta(gt=0, le=180)] | None = field(name="sigma_normal_deg", default=None)
    sigma_mount: Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.array()

    def array(self) -> TaxelArray:
        """The part of the rig; raises InvalidInput where there is none of such a size."""
        given = {name: value for name, value in self.given().items() if name != "pose"}
        return TaxelArray(T_frame_grid=(self.pose or LinkPoseForm()).matrix(), **given)


class VisionNoiseForm(Form):
    LONGEST: ClassVar = {"sigma_position": LARGEST_HELD}

    sigma_position: AtLeastZero | None = field(name="position", default=None)
    sigma_rotation: Angle | None = field(name="rotation_deg", default=None)


class IntrinsicsForm(Form):
    """[pixels]"""

    width: Pixels
    height: Pixels
    fx: Pixels
    fy: Pixels
    cx: Pixels
    cy: Pixels


class CameraForm(Form):
    fixed_to: Literal["world", "palm"] = "world"
    pose: PoseForm | None = None
    noise: VisionNoiseForm | None = None
    constant_error: VisionNoiseForm | None = None
    intrinsics: IntrinsicsForm | None = None
    lens: list[float] | None = None
    """k1, k2, p1, p2[, k3[, k4, k5, k6]]."""
    depth_camera: DepthCamera | None = None

    def __post_init__(self) -> None:
        if self.lens is not None:
            check_lens(self.lens, "lens")
        if self.lens and self.intrinsics is None:
            raise ValueError("lens: expected intrinsics beside it, got none")

    def camera(self) -> Camera:
        """The part of the rig."""
        constant, k = (self.constant_error or VisionNoiseForm()).sigmas(), self.intrinsics
        return Camera(
            on=self.fixed_to,
            T_mount_camera=(self.pose or PoseForm()).matrix(),
            intrinsics=None if k is None else np.array([[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1.0]]),
            size=None if k is None else (int(k.width), int(k.height)),
            lens=np.array(self.lens or [], dtype=np.float64),
            depth_camera=self.depth_camera or "structured_light",
            **(self.noise or VisionNoiseForm()).sigmas(),
            **{f"{name}_constant": value for name, value in constant.items()},
        )


class TableForm(Form):
    LONGEST: ClassVar = {"height": FARTHEST, "sigma_height": LARGEST_HELD}

    height: float
    sigma_height: Positive | None = None
    sigma_tilt: Angle | None = field(name="sigma_tilt_deg", default=None)


class WorldForm(Form):
    gravity: Vector = (0.0, 0.0, -9.81)
    palm_from: Literal["tf", "joints", "nowhere"] = "tf"

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.gravity))
        if not 1.5 <= length <= 30:
            raise ValueError(f"gravity: expected a vector of 1.5 to 30 m/s², got length {length:.3g}")


class FramesForm(Form):
    world: Text = "world"
    palm: Text = "palm"
    camera: Text = "camera"


class TopicsForm(Form):
    joint_states: Text | None = None
    wrenches: dict[str, Text] | None = None
    contacts: dict[str, Text] | None = None
    """Of tips that sense contacts themselves."""
    skin: dict[str, Text] | None = None
    vision: Text | None = None
    tf: Text | None = None
    color: Text | None = None
    depth: Text | None = None
    camera_info: Text | None = None
    truth: Text | None = None


class RigForm(Form):
    version: float
    hand: HandForm
    fingers: dict[str, FingerForm]
    camera: CameraForm | None = None
    table: TableForm | None = None
    world: WorldForm | None = None
    frames: FramesForm | None = None
    topics: TopicsForm | None = None
    objects: dict[str, ObjectForm] | None = None
    skin: dict[str, SkinForm] | None = None

    def __post_init__(self) -> None:
        if not self.fingers:
            raise ValueError("fingers: expected at least one finger, got none")
