"""Draws the README's moving picture: vision's ghost, the hand closes, the object snaps, open directions stay blue.

The simulated Shadow hand grasps, pushes and lifts a can, which vision sees centimetres off. A minute; writes
`docs/demo.gif`, or another file: `python -m experiments.moving_picture --output FILE` (GIF or WebP).
"""

import argparse
from collections.abc import Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import handsight as hs
from handsight.correction import PoseEstimate
from handsight.simulation import Sample, Scenario, camera_facing, rig_of, simulate
from handsight.simulation.scene import scene
from handsight.viewer.shapes import middle, open_direction
from handsight.vision.pixels import Color
from testbed.pictures import Line, PictureRenderer, Rgba
from testbed.report import Array, wrote

SCENARIO = Scenario(object="can", seed=0, motion="manipulate")
TIMES = (
    *np.arange(0.1, 1.0, 0.05),
    *np.arange(1.0, 8.6, 0.25),
)  # of the frames [s]: slowly while the hand closes
FRAME, FIRST_FRAME, LAST_FRAME = 140, 1200, 2000  # how long each is shown [ms]
AWAY = np.array([-0.11, 0.38, 0.20])  # of the camera from the object at the begin [m]
SIZE = 480, 360
VISION: Rgba = (0.0, 0.65, 0.8, 0.35)
TRACKED: Rgba = (1.0, 0.72, 0.0, 0.75)
OPEN: Rgba = (0.13, 0.4, 0.95, 1.0)
LEGEND = (("as vision sees it", VISION), ("as handsight tracks it", TRACKED), ("left open by touch", OPEN))
VIVID = 90  # difference of a pixel's channels from which the palette gives it more room
WIDTH = 0.006  # of an arrow [m]
OPACITY = 0.35  # of the true can, which nobody is told


def frames() -> Iterator[Image.Image]:
    """Yields the frames: the can as it is, as vision sees it, and as it is tracked."""
    rig = rig_of(SCENARIO)
    model = rig.objects["can"].model()
    tracker = hs.Tracker(rig, model)
    wanted = list(TIMES)
    seen: Array | None = None
    with closing(PictureRenderer(scene(SCENARIO.object))) as renderer:
        T_world_camera: Array | None = None
        for sample in simulate(SCENARIO):
            estimate = tracker.update(sample.observation)
            measured = tracker.vision.in_palm(tracker.processed, tracker.T_world_palm)
            seen = seen if measured is None else measured
            if T_world_camera is None:
                at = sample.T_world_object[:3, 3] + np.array([-0.02, 0.0, 0.06])
                T_world_camera = camera_facing(at + AWAY, at)
            if seen is None or estimate is None or sample.observation.stamp < wanted[0]:
                continue
            wanted.pop(0)
            lines = open_lines(estimate, model) if tracker.fingertips.fingers else []
            ghosts = [(estimate.T_palm_object, TRACKED), (seen, VISION)]
            picture = renderer.draw(sample.configuration, T_world_camera, ghosts, lines, opacity=OPACITY)
            yield labelled(picture, sentence(model, sample, seen, estimate, tracker.fingertips.fingers))
            if not wanted:
                return


def open_lines(estimate: PoseEstimate, model: hs.ObjectModel) -> list[Line]:
    """Returns arrows and arcs along the directions that touch leaves open."""
    lines = []
    for direction in estimate.unobservable:
        arrows, arc = open_direction(direction, middle(model, estimate.T_palm_object), model)
        lines += [Line(begin, end, WIDTH, OPEN, arrow=True) for begin, end in arrows]
        lines += [Line(begin, end, WIDTH / 2, OPEN, arrow=False) for begin, end in pairwise(arc)]
    return lines


def sentence(
    model: hs.ObjectModel, sample: Sample, seen: Array, estimate: PoseEstimate, fingers: tuple[str, ...]
) -> str:
    """Returns how far vision and the tracked pose are off, and how many fingers touch."""
    true = middle(model, sample.T_palm_object)
    by_vision, tracked = (
        1000 * np.linalg.norm(middle(model, T) - true) for T in (seen, estimate.T_palm_object)
    )
    return (
        f"fingers that touch: {len(fingers)}.   Off by: vision {by_vision:.0f} mm, handsight {tracked:.0f} mm"
    )


def labelled(picture: Color, text: str) -> Image.Image:
    """Returns a frame with a sentence above the picture and a legend below."""
    image = Image.fromarray(picture).resize(SIZE, Image.Resampling.LANCZOS)
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(14)
    draw.rectangle((0, 0, SIZE[0], 26), fill="white")
    draw.text((8, 4), text, fill="black", font=font)
    draw.rectangle((0, SIZE[1] - 24, SIZE[0], SIZE[1]), fill="white")
    left = 8
    for name, rgba in LEGEND:
        color = tuple(int(255 * channel) for channel in rgba[:3])
        draw.ellipse((left, SIZE[1] - 17, left + 10, SIZE[1] - 7), fill=color)
        draw.text((left + 16, SIZE[1] - 22), name, fill="black", font=font)
        left += 34 + int(draw.textlength(name, font=font))
    return image


def main() -> None:
    """Writes the moving picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent.parent / "docs/demo.gif")
    path = parser.parse_args().output
    drawn = list(frames())
    durations = [FIRST_FRAME, *[FRAME] * (len(drawn) - 2), LAST_FRAME]
    if path.suffix == ".gif":
        # One palette of all frames, without dithering, so that what stands still stays equal.
        pixels = np.concatenate([np.asarray(each)[::3, ::3].reshape(-1, 3) for each in drawn])
        vivid = pixels[np.ptp(pixels.astype(int), axis=1) > VIVID]
        few = np.concatenate([pixels, *[vivid] * 4])
        palette = Image.fromarray(few[None]).quantize()
        drawn = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in drawn]
    drawn[0].save(path, save_all=True, append_images=drawn[1:], duration=durations, loop=0, optimize=False)
    wrote(path)


if __name__ == "__main__":
    main()
