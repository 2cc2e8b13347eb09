"""Definitions of the messages of tactile sensors that rosbags does not know.

They are as the drivers state them: sr_robot_msgs of the Shadow Robot Company, tactile_msgs of ubi-agni/tactile_toolbox,
its_msgs, xela_server_ros2 of mcsix, inspire_hand_ros2 of laurent-19/inspire_hand_ws. A recording's own come first.
"""


def _xela(package: str) -> dict[str, str]:
    """Returns the definitions of a SensStream, by name in a package."""
    axes = "{0} x\n{0} y\n{0} z"
    return {
        f"{package}/msg/Taxel": axes.format("uint16"),
        f"{package}/msg/Forces": axes.format("float32"),
        f"{package}/msg/SensorFull": "uint32 message\nfloat64 time\nstring model\nuint8 sensor_pos\n"
        f"{package}/Taxel[] taxels\n{package}/Forces[] forces",
        f"{package}/msg/SensStream": f"{package}/SensorFull[] sensors",
    }


SHADOW = "sr_robot_msgs/msg/ShadowContactStateStamped"
TACTILE = "tactile_msgs/msg/TactileContact"
ITS = "its_msgs/msg/SoftContactSensingProblemSolution"
FINGERS = "little", "ring", "middle", "index", "thumb"
DEFINITIONS = {
    SHADOW: "std_msgs/Header header\ngeometry_msgs/Vector3 tangential_force\ngeometry_msgs/Point contact_position\n"
    "geometry_msgs/Vector3 contact_normal\nfloat64 f_normal\nfloat64 l_torque",
    TACTILE: "std_msgs/Header header\nstring name\ngeometry_msgs/Point position\ngeometry_msgs/Vector3 normal\n"
    "geometry_msgs/Wrench wrench",
    f"{TACTILE}s": "tactile_msgs/TactileContact[] contacts",
    ITS: "std_msgs/Header header\ngeometry_msgs/Point PoC\ngeometry_msgs/Vector3 n\nfloat64 Fn\n"
    "geometry_msgs/Vector3 Ft\nfloat64 T\nfloat64 D\nfloat64 convergence_time",
    "tactile_msgs/msg/TactileState": "std_msgs/Header header\nsensor_msgs/ChannelFloat32[] sensors",
    **_xela("xela_server_ros2"),
    **_xela("xela_server_ros"),
    "inspire_hand_ros2/msg/FingerTactile": "string name\nint16[] tip\nint16[] nail\nint16[] pad\n"
    "int16[] middle_section\nfloat32 total_pressure\nfloat32 max_pressure\nint32 contact_count",
    "inspire_hand_ros2/msg/InspireHandTouch": "std_msgs/Header header\n"
    + "".join(f"inspire_hand_ros2/FingerTactile {finger}\n" for finger in FINGERS)
    + "int16[112] palm\nfloat32 total_contact\nuint8 fingers_in_contact\nbool stable_contact",
}
"""Definitions by name; live messages bring none, but over ROS 1."""
CONTACTS = SHADOW, TACTILE, f"{TACTILE}s", ITS  # types that say where a fingertip is touched
NUMBERS = "Float32", "Float64", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32"
SINGLE = tuple(f"std_msgs/msg/{number}" for number in ("Bool", *NUMBERS))
PLAIN_TAXELS = (
    *(f"std_msgs/msg/{number}MultiArray" for number in NUMBERS),
    *(*SINGLE, "sensor_msgs/msg/Image", "sensor_msgs/msg/ChannelFloat32", "tactile_msgs/msg/TactileState"),
)
"""Types with readings of taxels that are found without a path into the message; of a TactileState by the name."""
TAXELS = (
    *PLAIN_TAXELS,
    "sensor_msgs/msg/PointCloud2",
    *(kind for kind in DEFINITIONS if kind.endswith(("/SensStream", "/InspireHandTouch"))),
)
"""Types with readings of taxels that are known without a definition from the recording."""
