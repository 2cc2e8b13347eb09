"""Whether the tips of a rig's fingers point out of their fingers."""

import math

import numpy as np

from handsight.rig.rig import Rig

NEAR_TIP = 0.008  # a joint nearer to a tip's centre does not say where its finger comes from [m]


def outward(rig: Rig) -> dict[str, float]:
    """Returns by finger the cosine between its tip's +z and the way from its last joint to the tip: -1 is wrong."""
    hand = rig.hand.kinematics(dict.fromkeys(rig.hand.moving, 0.0))
    found = dict[str, float]()
    for k, name in enumerate(rig.hand.tips):
        T = hand.Ts_palm_tip[k] @ rig.fingers[name].T_frame_surface
        anchors = hand.axes_palm[hand.chains.starts[k] : hand.chains.starts[k + 1], 1]
        ways = T[:3, 3] - anchors
        far = np.linalg.norm(ways, axis=1)
        far[far < NEAR_TIP] = math.inf
        nearest = far.argmin()
        found[name] = float(T[:3, 2] @ ways[nearest] / far[nearest]) if np.isfinite(far[nearest]) else 0.0
    return {name: found[name] for name in rig.fingers}
