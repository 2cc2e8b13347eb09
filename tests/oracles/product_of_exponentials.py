"""Forward kinematics of hinges and slides as a product of exponentials (Murray, Li and Sastry 1994), body by body."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from handsight import se3

SLIDE = 2
"""MuJoCo's number of a joint that slides; the others are hinges."""


def poses_in_world(model, positions):
    """(bodies, 4, 4) of a compiled MuJoCo model's bodies, with the joints that are named at `positions`."""
    Ts = np.tile(np.eye(4), (model.nbody, 1, 1))
    for body in range(1, model.nbody):  # parents come first
        R = se3.rotation_from_quaternion(model.body_quat[body, [1, 2, 3, 0]])
        Ts[body] = Ts[model.body_parentid[body]] @ se3.compose(R, model.body_pos[body])
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            axis, anchor = model.jnt_axis[joint], model.jnt_pos[joint]
            slides = model.jnt_type[joint] == SLIDE
            twist = np.array([0, 0, 0, *axis] if slides else [*axis, *np.cross(anchor, axis)])
            zero = model.qpos0[model.jnt_qposadr[joint]]
            along = positions.get(model.joint(joint).name, zero) - zero
            Ts[body] = Ts[body] @ RigidTransform.from_exp_coords(twist * along).as_matrix()
    return Ts


def poses_between(model, positions, base, bodies):
    """(t, 4, 4) of the named bodies in the body named `base`."""
    Ts = poses_in_world(model, positions)
    return se3.inverse(Ts[model.body(base).id]) @ Ts[[model.body(name).id for name in bodies]]
