"""`handsight ros2-bridge`: ROS 2's messages over DDS, in and out, where its own Python cannot load handsight."""

import signal
import threading
from pathlib import Path
from typing import Annotated

import typer

from handsight.cli.options import ObjectName, renamed
from handsight.cli.terminal import announce_compiling, say


def ros2_bridge(
    rig: Annotated[Path, typer.Argument(help="The robot: the rig file that track takes.")],
    object: ObjectName = None,
    rate: Annotated[
        float | None, typer.Option(min=0.1, help="Corrections a second; default: when something changed.")
    ] = None,
    images: Annotated[bool, typer.Option(help="Look at depth images, where the rig names some.")] = True,
    as_recorded: Annotated[
        bool,
        typer.Option(
            "--as-recorded", help="Wait for messages as for a recording: 0.2 s late, the same numbers."
        ),
    ] = False,
    old_equal: Annotated[bool, typer.Option("--equal", hidden=True)] = False,
    view: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of a page that shows it in the browser; 0: none.")
    ] = 0,
) -> None:
    """Follow an object in a robot's hand over ROS 2, without ROS installed here.

    Heard are the rig's topics, published are /handsight/pose, /tf, /handsight/markers and /diagnostics, until Ctrl-C.
    ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST and CYCLONEDDS_URI are obeyed. Asked for things are topics:

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

    as_recorded = renamed(as_recorded, old_equal, ("--as-recorded", "--equal"))
    live = live_tracker(rig, object, encoding="cdr", rate=rate, images=images, equal=as_recorded)
    bridge = Bridge(live, Network(), say)
    if view:
        viewer = Viewer(live.tracker, port=view)
        live.show = viewer.update
        say(f"look at {viewer.address}")
    worker = threading.Thread(target=work, args=(bridge, bridge.publish, say, ended), daemon=True)
    worker.start()
    say(
        f"the bridge is ready: it follows {live.tracker.model.name}, {len(live.subscriptions)} topics are heard"
    )
    while not ended.wait(1.0):
        bridge.check_network()
    worker.join(1.0)
