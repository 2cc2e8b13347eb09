"""Built by colcon; unbuilt, handsight_ros2/node.py runs as it is."""

from setuptools import setup

NAME = "handsight_ros2"
setup(
    name=NAME,
    version="1.0.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/handsight.launch.py"]),
        (f"share/{NAME}/rviz", ["rviz/handsight.rviz"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    description="Where the object is in the robot's hand, by touch and sight: the node for ROS 2.",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"node = {NAME}.node:main"]},
)
