"""Writes what docs/rviz.md shows in RViz: `python docs/rviz.py FOLDER`.

`can.bag`, the demo's recording for ROS 1; `can.rig.yaml`; and `hand.urdf` with its meshes, the simulated hand as
`robot_state_publisher` and RViz read it. The root of the URDF is the palm, which the recording's /tf places.
"""

import argparse
import os
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
import trimesh
from rosbags import rosbag1
from scipy.spatial.transform import Rotation

from handsight.cli.demo import DATA
from handsight.messages.decode import typestore
from handsight.messages.topics import rig_topics
from handsight.recording.mcap import McapSource
from handsight.rig import Rig

PALM = "robot0:palm"


def origin(parent: Xml.Element, position: np.ndarray, wxyz: np.ndarray) -> None:
    """Adds a pose to an element."""
    rpy = Rotation.from_quat(wxyz, scalar_first=True).as_euler("xyz")
    numbers = {"xyz": position, "rpy": rpy}
    Xml.SubElement(
        parent, "origin", {key: " ".join(f"{x:.9g}" for x in each) for key, each in numbers.items()}
    )


def urdf(folder: Path) -> None:
    """Writes the hand below the palm."""
    package = find_spec("gymnasium_robotics")
    assert package is not None
    assert package.origin is not None
    model = mujoco.MjModel.from_xml_path(str(Path(package.origin).parent / "envs/assets/hand/reach.xml"))
    robot, links = Xml.Element("robot", name="hand"), {model.body(PALM).id: "palm"}
    for body in range(model.nbody):
        parent = int(model.body_parentid[body])
        if body not in links and parent in links:
            links[body] = model.body(body).name.replace("robot0:", "")
            number = int(model.body_jntadr[body])
            kind = "fixed" if number < 0 else "revolute"
            name = links[body] if number < 0 else model.joint(number).name
            joint = Xml.SubElement(robot, "joint", name=name, type=kind)
            origin(joint, model.body_pos[body], model.body_quat[body])
            Xml.SubElement(joint, "parent", link=links[parent])
            Xml.SubElement(joint, "child", link=links[body])
            if number >= 0:
                lower, upper = model.jnt_range[number]
                Xml.SubElement(joint, "axis", xyz=" ".join(map(str, model.jnt_axis[number])))
                Xml.SubElement(joint, "limit", lower=str(lower), upper=str(upper), effort="1", velocity="1")
    for body, name in links.items():
        link = Xml.SubElement(robot, "link", name=name)
        for geom in np.flatnonzero(
            (model.geom_bodyid == body) & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
        ):
            mesh, path = model.mesh(model.geom_dataid[geom]), folder / f"{geom}.stl"
            vertices = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
            faces = model.mesh_face[mesh.faceadr[0] :][: mesh.facenum[0]]
            trimesh.Trimesh(vertices, faces).export(path)
            visual = Xml.SubElement(link, "visual")
            origin(visual, model.geom_pos[geom], model.geom_quat[geom])
            Xml.SubElement(Xml.SubElement(visual, "geometry"), "mesh", filename=path.as_uri())
            Xml.SubElement(Xml.SubElement(visual, "material", name="grey"), "color", rgba="0.75 0.75 0.8 1")
    Xml.indent(robot)
    Xml.ElementTree(robot).write(folder / "hand.urdf")


def bag(folder: Path) -> None:
    """Writes the demo's recording as a bag, and its rig."""
    rig, store, cdr = Rig.from_file(DATA / "can.rig.yaml"), typestore("ros1"), typestore("cdr")
    (folder / "can.rig.yaml").write_bytes((DATA / "can.rig.yaml").read_bytes())
    with rosbag1.Writer(folder / "can.bag") as writer:
        connections = {}
        for each in McapSource(DATA / "can.mcap").messages(rig_topics(rig)):
            if each.topic not in connections:
                connections[each.topic] = writer.add_connection(each.topic, each.type, typestore=store)
            data = cdr.cdr_to_ros1(each.data, each.type)
            writer.write(connections[each.topic], round(1e9 * each.log_time), data)


def main() -> None:
    """Writes all three."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("folder", type=Path)
    folder = arguments.parse_args().folder.resolve()
    os.makedirs(folder)
    urdf(folder)
    bag(folder)


if __name__ == "__main__":
    main()
