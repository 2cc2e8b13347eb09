"""The node with its parameters: `ros2 launch handsight_ros2 handsight.launch.py rig:=/path/to/rig.yaml object:=can`.

Unbuilt: `ros2 launch ros/handsight_ros2/launch/handsight.launch.py ...`. HANDSIGHT_PYTHON: the Python that handsight is
installed in, where that is not ROS' own; it must be of the same version.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

HERE = Path(__file__).resolve().parents[1]
UNBUILT = HERE / "handsight_ros2" / "node.py"
ARGUMENTS = (
    ("rig", None, str, "the rig file"),
    ("object", "", str, "its name in the rig or the library, or a mesh file; empty: the rig's only one"),
    ("images", "true", bool, "use depth images, where the rig names a topic of them"),
    ("rate", "0.0", float, "corrections a second; 0: one when something has changed"),
    (
        "equal",
        "false",
        bool,
        "answer as `handsight track` does with a recording: 0.2 s later, the same numbers",
    ),
    ("view", "0", int, "port of a page that shows it in the browser; 0: none"),
)


def generate_launch_description():
    """Returns the node and, where it is wanted, RViz."""
    declared = [
        DeclareLaunchArgument(
            name, description=what, **({} if default is None else {"default_value": default})
        )
        for name, default, _, what in (*ARGUMENTS, ("rviz", "false", bool, "show it"))
    ]
    given = {
        name: ParameterValue(LaunchConfiguration(name), value_type=kind) for name, _, kind, _ in ARGUMENTS
    }
    node = Node(
        package=None if UNBUILT.is_file() else "handsight_ros2",
        executable=str(UNBUILT) if UNBUILT.is_file() else "node",
        name="handsight",
        output="screen",
        prefix=[EnvironmentVariable("HANDSIGHT_PYTHON", default_value="python3")],
        parameters=[given],
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        name="handsight_rviz",
        arguments=["-d", str(HERE / "rviz" / "handsight.rviz")],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    return LaunchDescription([*declared, node, rviz])
