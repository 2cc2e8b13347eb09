"""The errors of depth cameras: noise, constant biases, and pixels without depth."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import ArrayLike

from handsight import checks
from handsight.checks import Array
from handsight.errors import InvalidInput
from handsight.rig.rig import DepthCamera

SIZES = ("step", "lateral", "smooth", "offset")
SHARES = ("correlated", "edges", "dropouts")
LARGEST = 100  # no number of a camera's errors is larger, in its unit


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthNoise:
    """The errors of a kind of depth camera along its optical axis, at depth z [m]; each sigma is one
    standard deviation.

    Noise is different in each image. Smooth bias and offset are constant for one camera, as its calibration left them.
    """

    axial: tuple[float, float, float]
    """Noise of a pixel: sigma a + b z + c z² [m], which includes that of rounding to steps."""
    step: float = 0.0
    """Between neighbouring depths at 1 m [m]; it grows with z², because the disparity is rounded. 0: none."""
    correlated: float = 0.0
    """Share of the noise's variance, without that of rounding, that neighbouring pixels have in common."""
    correlation: float = 5
    """Distance at which their correlation has fallen to 1/e [pixels]."""
    lateral: float = 0.0
    """Sigma of the offset per axis between a pixel and the place that it measures, before it is rounded [pixels]."""
    smooth: float = 0.0
    """Constant bias that changes over the image: sigma at 1 m [m]; it grows with z²."""
    smooth_length: float = 40
    """Distance at which its correlation has fallen to 1/e [pixels]."""
    offset: float = 0.0
    """Constant bias of the whole image: sigma [m]."""
    edges: float = 0.0
    """Share of the pixels without depth among those within `edge_width` of something nearer."""
    edge_width: int = 2
    """[pixels]"""
    dropouts: float = 0.0
    """Share of the pixels without depth elsewhere."""
    nearest: float = 0.0
    """Surfaces nearer than this have no depth [m]."""
    farthest: float = LARGEST
    """Surfaces farther than this have no depth [m]."""

    def __post_init__(self) -> None:
        """Raises InvalidInput for a size, share or range that is not possible."""
        checks.finite(self.axial, "axial", (3,))
        checks.integer(self.edge_width, "edge_width", int(LARGEST))
        for name in (*SIZES, *SHARES, "correlation", "smooth_length", "nearest", "farthest"):
            value = float(checks.finite(getattr(self, name), name, ()))
            most = 1.0 if name in SHARES else LARGEST
            if not 0 <= value <= most:
                raise InvalidInput(f"{name}: expected a number from 0 to {most:g}, got {value:g}")
        if not self.nearest < self.farthest:
            expected = f"expected more than nearest, {self.nearest:g}"
            raise InvalidInput(f"farthest: {expected}, got {self.farthest:g}")

    def sigma(self, z: ArrayLike) -> Array:
        """Returns the standard deviation [m] of a pixel's depth z [m] from image to image, of z's shape."""
        a, b, c = self.axial
        depth = np.asarray(z, dtype=np.float64)
        return np.asarray(np.maximum(a + depth * (b + depth * c), 0.0))

    def bias(self, z: ArrayLike) -> Array:
        """Returns the standard deviation [m] of the error of a depth z [m] that is the same in each image: no number of
        images, or of pixels near one place, lowers it."""
        return np.hypot(self.offset, self.smooth * np.square(np.asarray(z, dtype=np.float64)))

    def times(self, amount: float) -> "DepthNoise":
        """Returns a noise whose errors, and shares of pixels without depth, are `amount` times as large; raises
        InvalidInput."""
        amount = float(checks.finite(amount, "amount", ()))
        if amount < 0:
            raise InvalidInput(f"amount: expected a number of at least 0, got {amount:g}")
        a, b, c = self.axial
        changed = {name: amount * getattr(self, name) for name in SIZES}
        changed |= {name: min(amount * getattr(self, name), 1.0) for name in ("edges", "dropouts")}
        return dataclasses.replace(self, axial=(amount * a, amount * b, amount * c), **changed)


PRESETS = msgspec.json.decode(
    (Path(__file__).parents[1] / "data/depth_cameras.json").read_bytes(), type=dict[DepthCamera, DepthNoise]
)
"""Each kind of depth camera by its name in a rig.

structured_light: a Kinect; disparity in eighths of a pixel, 2.85 mm at 1 m (Barron and Malik, CVPR 2013; Handa and
others, ICRA 2014), with noise of .35 of a step over 5 pixels, .25 white and 1/12 of rounding, squared. That is 1.5 mm
z², as Khoshelham and Oude Elberink (Sensors 2012) measured. Nguyen, Izadi and Lovell (3DIMPVT 2012) measured 1.2 + 1.9
(z - .4)² mm about planes fitted to the image, which include the smooth bias: both together are within a third of that
from .65 to 1.4 m, and less nearer.

time_of_flight: a Kinect v2; 1.5 - 0.5 z + 0.3 z² mm (Fankhauser and others, ICAR 2015, facing the camera). Its
successor's distances are off by up to 11 mm (Tölgyessy and others, Sensors 2021). The smooth part is assumed, the edges
are those of structured_light, and light that comes by way of other surfaces is not modelled.

stereo: an active stereo camera as the RealSense D435; .08 pixels of disparity, z² · .08 px / (f B), at f = 425 px and
B = 5 cm, in steps of 1/32 pixel. The correlation (by the matched window), the bias and the edges are assumed.
"""
STRUCTURED_LIGHT = PRESETS["structured_light"]
