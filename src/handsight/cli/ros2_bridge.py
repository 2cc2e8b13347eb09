"""`handsight ros2-bridge`: a live tracker on ROS 2's network, for a Python without ROS."""

import signal
import threading
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from handsight.cli.options import ObjectName
from handsight.cli.terminal import announce_compiling, say


def ros2_bridge(
    rig: Annotated[Path, Argument(help="Rig file of the robot.")],
    object: ObjectName = None,
    rate: Annotated[
        float | None,
        Option(min=0.1, help="Corrections per second. Default: whenever a contact has changed."),
    ] = None,
    images: Annotated[
        bool, Option(help="Find the object in the depth images, if the rig names their topic.")
    ] = True,
    as_recorded: Annotated[
        bool,
        Option(
            "--as-recorded",
            help="Wait 0.2 s for late messages, so that the poses equal those of `handsight track` for a recording.",
        ),
    ] = False,
    port: Annotated[
        int,
        Option(min=0, max=65535, help="Port of a page that shows the tracker in the browser. 0: no page."),
    ] = 0,
) -> None:
    """Track an object in a robot's hand over ROS 2; ROS need not be installed on this machine.

    It subscribes to the rig's topics and publishes /handsight/pose, /tf, /handsight/markers and /diagnostics until
    Ctrl-C. ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST and CYCLONEDDS_URI have their usual meaning. Messages
    on topics request another object, or a new track:

    ```
    handsight ros2-bridge robot.yaml --object can
    ros2 topic pub --once /handsight/object std_msgs/msg/String "{data: mustard}"
    ros2 topic pub --once /handsight/reset std_msgs/msg/Empty
    ```
    """
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    announce_compiling()
    from handsight.bridge import Bridge, Network
    from handsight.live.node import live_tracker, work
    from handsight.viewer import Viewer

    live = live_tracker(rig, object, encoding="cdr", rate=rate, images=images, equal=as_recorded)
    bridge = Bridge(live, Network(), say)
    if port:
        viewer = Viewer(live.tracker, port=port)
        live.show = viewer.update
        say(f"look at {viewer.address}")
    worker = threading.Thread(target=work, args=(live, bridge.step, bridge.publish, say, ended), daemon=True)
    worker.start()
    heard = f"{len(live.subscriptions)} topics are heard"
    say(f"the bridge is ready: it follows {live.tracker.model.name}, {heard}")
    while not ended.wait(1.0):
        bridge.check_network()
    worker.join(1.0)
